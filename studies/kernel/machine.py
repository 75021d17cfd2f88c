"""A virtual machine: the kernel that it boots, kept in .cache/, and its process."""

import contextlib
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

from studies.testbed.processes import read_processor_s

# --- kernels to boot: Debian's, downloaded once and kept in .cache/

CACHE = Path(__file__).resolve().parents[2] / ".cache" / "kernel"


class Flavour(NamedTuple):
    """One of Debian's kernels, and the modules that are loaded, each after those it needs."""

    package: str  # that depends on the newest one
    folder: Path
    modules: tuple[str, ...]


HID = Flavour(
    "linux-image-cloud-amd64",
    CACHE,
    (
        "drivers/hid/hid",
        "drivers/hid/uhid",
        "drivers/hid/hid-generic",
        "drivers/leds/led-class-multicolor",
        "drivers/input/ff-memless",
        "drivers/hid/hid-playstation",
        "drivers/input/evdev",
    ),
)
CAN = Flavour(
    "linux-image-amd64",  # that for clouds has no CAN
    CACHE.with_name("kernel-full"),
    ("net/can/can", "net/can/can-raw", "drivers/net/can/dev/can-dev", "drivers/net/can/vcan"),
)
_QEMU = "qemu-system-x86"
EMULATOR = "qemu-system-x86_64"


class MissingError(Exception):
    """Something is not there and cannot be installed; the message names the remedy."""


def find_emulator() -> str:
    """Return the path of qemu, installed if need be."""
    if found := shutil.which(EMULATOR):
        return found
    if not shutil.which("apt-get") or os.geteuid() != 0:
        raise MissingError(f"{EMULATOR} is missing: apt-get install {_QEMU} (as root)")
    _apt("update")
    _apt("install", "--no-install-recommends", "-y", _QEMU)
    return shutil.which(EMULATOR) or EMULATOR


def find_kernel(flavour: Flavour = HID) -> tuple[Path, list[Path]]:
    """Return a kernel and its modules, in the order to load them."""
    folder = flavour.folder
    if not (folder / "complete").exists():
        _download(flavour)
    found = [next((folder / "modules").glob(f"{Path(name).name}.ko*")) for name in flavour.modules]
    return folder / "vmlinuz", found


def _download(flavour: Flavour) -> None:
    folder = flavour.folder
    if not shutil.which("apt-get") or not shutil.which("dpkg-deb"):
        raise MissingError(
            f"no Debian kernel in {folder}, and no apt-get to download it: use Debian"
        )
    shutil.rmtree(folder, ignore_errors=True)
    unpacked = folder / "package"
    unpacked.mkdir(parents=True)
    package = _find_package(flavour.package)
    _run("apt-get", "download", package, folder=folder)
    (archive,) = folder.glob("*.deb")
    _run("dpkg-deb", "-x", str(archive), str(unpacked), folder=folder)
    (image,) = (unpacked / "boot").glob("vmlinuz-*")
    (drivers,) = unpacked.glob("**/kernel/drivers")
    image.rename(folder / "vmlinuz")
    (folder / "modules").mkdir()
    for name in flavour.modules:
        (module,) = (drivers.parent / name).parent.glob(f"{Path(name).name}.ko*")
        module.rename(folder / "modules" / module.name)
    shutil.rmtree(unpacked)
    archive.unlink()
    (folder / "complete").write_text(f"{package}\n")


def _find_package(meta: str) -> str:
    """Return the newest kernel package, after an update of apt's lists if they know none."""
    for update in (False, True):
        if update and os.geteuid() == 0:
            _apt("update")
        shown = subprocess.run(
            ["apt-cache", "depends", "--important", meta],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=False,
        ).stdout
        for line in shown.splitlines():
            kind, _, package = line.strip().partition(" ")
            if kind == "Depends:":
                return package
    raise MissingError(f"apt knows no {meta}: apt-get update (as root, on Debian)")


def _apt(*arguments: str) -> None:
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    _run("apt-get", "-qq", *arguments, environment=environment)


def _run(
    *command: str, folder: Path | None = None, environment: dict[str, str] | None = None
) -> None:
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        last = next((x for x in reversed(done.stdout.splitlines()) if x.startswith("E:")), "")
        raise MissingError(f"{' '.join(command)} failed: {last or done.stdout[-300:].strip()}")


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
        self, qemu: str, kernel: Path, initrd: Path, words: str, folder: Path, by_the_wall: bool
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
        with contextlib.suppress(OSError):  # it is gone
            self._worked_s = read_processor_s(self._process.pid)
        return self._worked_s

    @property
    def console(self) -> str:
        """What its kernel and its Python had to say."""
        return self._console.read_text(errors="replace") if self._console.exists() else ""

    def take_news(self) -> list[dict[str, Any]]:
        """Return the results that have come since the last call."""
        lines = self._results.read_text().splitlines(keepends=True)
        new = [line for line in lines[self._lines_read :] if line.endswith("\n")]
        self._lines_read += len(new)
        return [json.loads(line) for line in new]
