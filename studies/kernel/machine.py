"""One virtual machine: booted, listened to, and gone again."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

_PROCESSOR = "Nehalem,+rdrand"  # what numpy needs, and a source of random numbers; no more
_COMMAND_LINE = "console=ttyS0 quiet panic=-1 mitigations=off random.trust_cpu=on tsc=reliable"
_COUNTED = ("-accel", "tcg,thread=single", "-icount", "shift=1,sleep=off", "-smp", "1")
_BY_THE_WALL = ("-accel", "tcg,thread=multi", "-smp", "2")
_MEMORY_MB = 640


class Machine:
    """Runs from construction on, and ends by itself, or with the block.

    Parameters
    ----------
    folder : Path
        Where it keeps what it says.
    by_the_wall : bool
        Whether its clock is that of the wall; otherwise it counts instructions, one in 2 ns, and a
        busy host makes it slow, not late.
    """

    def __init__(
        self,
        qemu: str,
        kernel: Path,
        initrd: Path,
        words: str,
        folder: Path,
        by_the_wall: bool,
    ) -> None:
        folder.mkdir()
        self._results, self._console = folder / "results", folder / "console"
        self._results.touch()
        self._lines_read, self._worked_s = 0, 0.0
        self._process = subprocess.Popen(
            [
                qemu,
                *(_BY_THE_WALL if by_the_wall else _COUNTED),
                *("-cpu", _PROCESSOR, "-m", str(_MEMORY_MB)),
                *("-kernel", str(kernel), "-initrd", str(initrd)),
                *("-append", f"{_COMMAND_LINE} {words}"),
                *("-display", "none", "-nodefaults", "-no-reboot"),
                *("-serial", f"file:{self._console}", "-serial", f"file:{self._results}"),
            ],
            stdin=subprocess.DEVNULL,
        )

    def __enter__(self) -> "Machine":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    @property
    def runs(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    @property
    def worked_s(self) -> float:
        """Processor time that it has used [s]; of Linux."""
        try:
            status = Path(f"/proc/{self._process.pid}/stat").read_text()
        except OSError:  # it is gone
            return self._worked_s
        user, system = status.rpartition(")")[2].split()[11:13]
        self._worked_s = (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        return self._worked_s

    @property
    def console(self) -> str:
        """What its kernel and its Python had to say."""
        return self._console.read_text(errors="replace") if self._console.exists() else ""

    def news(self) -> list[dict[str, Any]]:
        """Return the results that have come since the last call."""
        lines = self._results.read_text().splitlines(keepends=True)
        new = [line for line in lines[self._lines_read :] if line.endswith("\n")]
        self._lines_read += len(new)
        return [json.loads(line) for line in new]
