"""Where this program runs: a container, WSL, a display of another machine; what fits there."""

import os
import platform
import re
import socket
import sys
from contextlib import suppress
from pathlib import Path

ROOT = Path("/")  # of the files that tell
CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # of a container: microseconds in a period, or max
_CONTAINER_FILES = {".dockerenv": "Docker", "run/.containerenv": "Podman"}


def find_container() -> str:
    """Return what kind of container this is, as in 'Docker'; empty if it is none."""
    if "KUBERNETES_SERVICE_HOST" in os.environ:
        return "Kubernetes"
    for name, kind in _CONTAINER_FILES.items():
        if (ROOT / name).exists():
            return kind
    return os.environ.get("container", "").capitalize()  # noqa: SIM112 - systemd's name


def is_wsl() -> bool:
    """Return whether this is Linux in Windows."""
    return "microsoft" in platform.release().lower()


def describe_machine() -> str:
    """Return system and surroundings, as in 'Linux 6.1.0, in a Docker container'."""
    container = find_container()
    place = f", in a container ({container})" if container else ", in WSL" if is_wsl() else ""
    return f"{platform.system()} {platform.release()}{place}"


def count_processors() -> int:
    """Return the number of processors that this process may use, by its cores and its quota."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    with suppress(OSError, ValueError):
        quota, period = map(float, CPU_QUOTA.read_text().split())
        return max(1, min(cores, int(quota / period)))
    return cores


def find_realtime_remedy() -> str:
    """Return how real-time priority and locked memory are granted here."""
    if find_container() == "Kubernetes":
        return "securityContext: {capabilities: {add: [SYS_NICE, IPC_LOCK]}} of the container"
    if find_container():
        return "docker run --cap-add=sys_nice --ulimit rtprio=99 --ulimit memlock=-1 ..."
    if is_wsl():
        return "in this terminal: sudo prlimit --pid $$ --rtprio=50 --memlock=unlimited"
    return (
        "add 'NAME - rtprio 50' and 'NAME - memlock unlimited' to /etc/security/limits.conf "
        "(your user name for NAME) and log in again"
    )


def find_usb_remedy(device: str) -> str:
    """Return how what is plugged in gets in here; empty on a machine itself."""
    if find_container():
        return f"a container has what it is given: docker run --device {device} ..."
    if is_wsl():
        return "WSL has what Windows gives it: usbipd bind, then usbipd attach --wsl --busid BUSID"
    return ""


def find_display_problem() -> str:
    """Return why no window can be opened here; empty if one can be."""
    if sys.platform != "linux":
        return ""
    if is_wsl() and not (ROOT / "dev/dxg").exists():
        return "WSL without a graphics card (/dev/dxg)"
    display = os.environ.get("DISPLAY", "")
    if wayland := os.environ.get("WAYLAND_DISPLAY"):
        if Path(os.environ.get("XDG_RUNTIME_DIR", ""), wayland).is_socket():
            return ""
        display = display or wayland
    if not display:
        return "none"
    local = re.fullmatch(r"(?:unix)?:(\d+)(?:\.\d+)?", display)
    if local is None:
        return f"{display} is of another machine (ssh -X), without its graphics card"
    place = f"/tmp/.X11-unix/X{local[1]}"  # noqa: S108 - fixed by X
    if any(map(_is_answering, (place, f"\0{place}"))):
        return ""
    return f"{display} is set, but no display answers there"


def _is_answering(address: str) -> bool:
    """Return whether a Unix socket accepts a connection."""
    with socket.socket(socket.AF_UNIX) as asking, suppress(OSError):
        asking.settimeout(1.0)
        asking.connect(address)
        return True
    return False
