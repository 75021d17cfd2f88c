"""Real-time scheduling of a control process: priority, CPU limit, locked memory, cores.

The order in a process is: import, compile, `request_realtime`, open the link and the devices,
`enter_loop`, loop. Compiling after `request_realtime` would hold a core at real-time priority for
seconds; threads of the link that are started after it inherit the priority.

A thread at SCHED_FIFO that never sleeps blocks its core for everything else. Two limits apply: the
kernel gives real-time threads 95 % of the time (`kernel.sched_rt_runtime_us`), from
`limit_computing_time` on `RLIMIT_RTTIME` limits how long a thread may compute without sleeping. A
loop sleeps in every period, far below.
"""

import ctypes
import gc
import os
import re
import resource
import signal
import socket
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Literal

from teleop.config.ranges import build_ranged_field, check_ranges

CORES_MIN = 4  # with fewer, no core is reserved for a loop
OTHER_CORES_MIN = 2  # cores left for link threads and other programs

SOFT_LIMIT_US = 1_000_000  # [us] of computing without sleep: then ordinary scheduling
HARD_LIMIT_US = 3_000_000  # [us] then the kernel ends the process, if no handler can run

CORE_LOCK_NAME = "tendon-teleop-core-{core}"  # name of the abstract socket that a loop holds

HEAP_RESERVE = 8 << 20  # [B] touched beforehand and kept by malloc

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_MADV_DONTNEED = 4
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_HEAPS_MAX = 2
_HEAP_THRESHOLD_MAX = 32 << 20  # [B] the highest threshold that glibc takes

_COMPILER = "libllvmlite"


@dataclass(frozen=True, slots=True)
class RealtimeConfig:
    """Scheduling of the control processes of this machine."""

    # SCHED_FIFO, 1 to 49 (interrupt threads of the kernel have 50); 0: ordinary
    priority: int = build_ranged_field(20, 0, 49)
    # cores of which each loop takes one for itself; auto: the upper half; []: none. From 4 cores on
    cores: Literal["auto"] | tuple[int, ...] = "auto"

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.cores != "auto" and any(core < 0 for core in self.cores):
            raise ValueError("cores: must not be negative")


_DEFAULT = RealtimeConfig()


def request_realtime(config: RealtimeConfig = _DEFAULT) -> list[str]:
    """Request real-time scheduling and memory locking; return what was granted."""
    granted: list[str] = []
    if config.priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(config.priority))
            granted.append("SCHED_FIFO")
        except (AttributeError, PermissionError, OSError):
            granted.append("no SCHED_FIFO (see `teleop doctor`)")
    _release_compiler()
    _reserve_heap()
    if _lock_memory():
        granted.append("memory locked")
    return granted


@contextmanager
def use_ordinary_scheduling() -> Iterator[None]:
    """Compute for seconds at ordinary priority, in a thread that is at real-time priority else."""
    if not hasattr(os, "sched_getscheduler") or os.sched_getscheduler(0) != os.SCHED_FIFO:
        yield
        return
    before = os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_FIFO, before)


def share_heaps() -> None:
    """Let all threads share few heaps: each own one keeps what a backlog took once.

    To be called before there are threads.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_ARENA_MAX, _HEAPS_MAX)


def enter_loop(granted: list[str], config: RealtimeConfig = _DEFAULT) -> None:
    """Prepare the calling thread for its loop: `limit_computing_time`, then `pin_loop`."""
    limit_computing_time(granted)
    pin_loop(granted, config)


def limit_computing_time(granted: list[str]) -> None:
    """Limit how long a thread at real-time priority may compute without sleeping.

    Beyond `SOFT_LIMIT_US` the whole process goes back to ordinary scheduling, says so on standard
    error and in `granted`. In compiled code that never returns no handler can run: beyond
    `HARD_LIMIT_US` the kernel ends the process.
    """
    if not hasattr(resource, "RLIMIT_RTTIME"):
        return
    signal.signal(signal.SIGXCPU, _build_limit_handler(granted))
    present = resource.getrlimit(resource.RLIMIT_RTTIME)
    resource.setrlimit(resource.RLIMIT_RTTIME, compute_rttime_limits(*present))


def pin_loop(granted: list[str], config: RealtimeConfig = _DEFAULT) -> None:
    """Move the calling thread to a free core of the loops; add it to `granted`.

    The other threads of the process, and their children, are kept off the cores of the loops. No
    effect if `divide_cores` gives none or all are taken.
    """
    if not hasattr(os, "sched_getaffinity"):
        return
    loops, other_cores = divide_cores(os.sched_getaffinity(0), config.cores)
    own = next((core for core in loops if _claim_core(core)), None)
    if own is None:
        return
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(int(thread), other_cores)
    os.sched_setaffinity(0, {own})
    granted.append(f"core {own} for the loop")


def divide_cores(
    allowed: Collection[int], setting: Literal["auto"] | Collection[int]
) -> tuple[list[int], set[int]]:
    """Divide the cores that a process may use between loops and other threads.

    `allowed` are those that the process may use, `setting` those for loops, of which each takes
    one; "auto" is the upper half. Returns those for loops, in order of preference, and the others;
    none with fewer than `CORES_MIN` cores, or if fewer than `OTHER_CORES_MIN` would be left.
    """
    cores = sorted(set(allowed), reverse=True)
    if len(cores) < CORES_MIN:
        return [], set()
    if setting == "auto":
        loops = cores[: len(cores) // 2]
    else:
        loops = [core for core in dict.fromkeys(setting) if core in cores]
    other_cores = set(cores).difference(loops)
    if not loops or len(other_cores) < OTHER_CORES_MIN:
        return [], set()
    return loops, other_cores


def compute_rttime_limits(soft: int, hard: int) -> tuple[int, int]:
    """Return the limits of RLIMIT_RTTIME [us], at most the present `soft` and `hard`.

    The soft one stays below the hard one, so that it is reached first.
    """
    highest = HARD_LIMIT_US if hard == resource.RLIM_INFINITY else min(hard, HARD_LIMIT_US)
    lower = SOFT_LIMIT_US if soft == resource.RLIM_INFINITY else min(soft, SOFT_LIMIT_US)
    return min(lower, highest // 2), highest


def _build_limit_handler(granted: list[str]) -> Callable[[int, FrameType | None], None]:
    """Return the handler of SIGXCPU, which ends real-time scheduling of all threads."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))
        warning = f"SCHED_FIFO disabled: computed for {SOFT_LIMIT_US / 1e6:g} s without sleeping"
        granted.append(warning)
        os.write(2, f"WARNING: {warning}\n".encode())  # the signal may interrupt print

    return handle


def _lock_memory() -> bool:
    """Lock resident pages, and others when they become resident.

    Without MCL_ONFAULT every mapped page becomes resident: the heaps that malloc reserves for each
    thread, stacks of 8 MB, libraries as a whole: 600 MB in the slave, of which 170 MB are used.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mlockall"):
        return False
    everything = _MCL_CURRENT | _MCL_FUTURE
    return any(libc.mlockall(flags) == 0 for flags in (everything | _MCL_ONFAULT, everything))


def _reserve_heap() -> None:
    """Touch memory that malloc then keeps resident for the loop."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt"):
        return
    libc.malloc.restype = ctypes.c_void_p
    libc.malloc.argtypes = [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    libc.mallopt(_M_MMAP_THRESHOLD, _HEAP_THRESHOLD_MAX)
    libc.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
    block = libc.malloc(HEAP_RESERVE)
    if block:
        ctypes.memset(block, 0, HEAP_RESERVE)
        libc.free(block)


def _release_compiler() -> None:
    """Release memory used for compiling, before it is locked.

    Free heap, and the compiler's code (50 MB): clean file pages, which can be read again.
    """
    gc.collect()
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    if not hasattr(libc, "madvise"):
        return
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    with suppress(OSError):
        for begin, size in find_unmodified_code(Path("/proc/self/smaps").read_text(), _COMPILER):
            libc.madvise(begin, size, _MADV_DONTNEED)


def find_unmodified_code(smaps: str, library: str) -> list[tuple[int, int]]:
    """Return address and size [B] of the unmodified code pages of `library`.

    `smaps` is the text of /proc/PID/smaps. Mappings with anonymous pages, such as relocations, are
    omitted: they cannot be read again.
    """
    mappings = []
    parts = re.split(r"^(?=[0-9a-f]+-[0-9a-f]+ )", smaps, flags=re.MULTILINE)
    for part in parts[1:]:
        head = part.split("\n", 1)[0].split(maxsplit=5)
        if len(head) < 6 or library not in head[5] or head[1] != "r-xp":
            continue
        if re.search(r"^Anonymous: +0 kB", part, flags=re.MULTILINE):
            begin, end = (int(address, 16) for address in head[0].split("-"))
            mappings.append((begin, end - begin))
    return mappings


def _claim_core(core: int) -> bool:
    """Reserve a core among the loops of this machine; return whether it was free.

    By an abstract socket name, which vanishes with the process.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind("\0" + CORE_LOCK_NAME.format(core=core))
    except OSError:
        claim.close()
        return False
    claim.detach()  # open until the process ends
    return True
