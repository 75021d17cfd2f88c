"""A kernel to boot: Debian's for virtual machines, downloaded once and kept in .cache/."""

import os
import shutil
import subprocess
from pathlib import Path

CACHE = Path(__file__).resolve().parents[2] / ".cache" / "kernel"
MODULES = (  # each after those it needs
    "hid/hid",
    "hid/uhid",
    "hid/hid-generic",
    "leds/led-class-multicolor",
    "input/ff-memless",
    "hid/hid-playstation",
    "input/evdev",
)
_META = "linux-image-cloud-amd64"
_QEMU = "qemu-system-x86"
EMULATOR = "qemu-system-x86_64"


class MissingError(Exception):
    """Something is not there and cannot be installed; the message names the remedy."""


def emulator() -> str:
    """Return the path of qemu, installed if need be."""
    if found := shutil.which(EMULATOR):
        return found
    if not shutil.which("apt-get") or os.geteuid() != 0:
        raise MissingError(f"{EMULATOR} is missing: apt-get install {_QEMU} (as root)")
    _apt("update")
    _apt("install", "--no-install-recommends", "-y", _QEMU)
    return shutil.which(EMULATOR) or EMULATOR


def kernel() -> tuple[Path, list[Path]]:
    """Return the kernel and its modules, in the order to load them."""
    if not (CACHE / "complete").exists():
        _download()
    found = [next((CACHE / "modules").glob(f"{Path(name).name}.ko*")) for name in MODULES]
    return CACHE / "vmlinuz", found


def _download() -> None:
    if not shutil.which("apt-get") or not shutil.which("dpkg-deb"):
        raise MissingError(
            f"no Debian kernel in {CACHE}, and no apt-get to download it: use Debian"
        )
    shutil.rmtree(CACHE, ignore_errors=True)
    unpacked = CACHE / "package"
    unpacked.mkdir(parents=True)
    package = _package()
    _run("apt-get", "download", package, folder=CACHE)
    (archive,) = CACHE.glob("*.deb")
    _run("dpkg-deb", "-x", str(archive), str(unpacked), folder=CACHE)
    (image,) = (unpacked / "boot").glob("vmlinuz-*")
    (drivers,) = unpacked.glob("**/kernel/drivers")
    image.rename(CACHE / "vmlinuz")
    (CACHE / "modules").mkdir()
    for name in MODULES:
        (module,) = (drivers / name).parent.glob(f"{Path(name).name}.ko*")
        module.rename(CACHE / "modules" / module.name)
    shutil.rmtree(unpacked)
    archive.unlink()
    (CACHE / "complete").write_text(f"{package}\n")


def _package() -> str:
    """Return the newest kernel package, after an update of apt's lists if they know none."""
    for update in (False, True):
        if update and os.geteuid() == 0:
            _apt("update")
        shown = subprocess.run(
            ["apt-cache", "depends", "--important", _META],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=False,
        ).stdout
        for line in shown.splitlines():
            kind, _, package = line.strip().partition(" ")
            if kind == "Depends:":
                return package
    raise MissingError(f"apt knows no {_META}: apt-get update (as root, on Debian)")


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
