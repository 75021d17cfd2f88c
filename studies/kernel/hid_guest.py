"""The HID checks, run as the first process of a virtual machine.

A check returns figures to be printed, or raises `WrongError`. What Linux does to a PID device at
plug-in, before anyone opens it, is played: the kernel's hid-pidff sits on USB, where a device made
by uhid does not; so its writes are played. OpenFFBoard's were captured on Debian 6.1, which cuts
the reset down to no bit at all in a mask. For the other devices the same steps are written with
their numbers; nobody has captured those.
"""

import multiprocessing
import os
import signal
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

from master.device import DeviceFault
from master.devices.hid import connection, search
from master.devices.hid.connection import POST_TIMEOUT_S, DeviceConnection
from master.devices.hid.device import HidDevice
from master.devices.hid.driver import Controls
from master.devices.hid.driver_table import DRIVERS
from master.devices.hid.force_signs import ForceSign, ForceSigns, save
from master.devices.hid.input_map import AxisConfig, HidConfig
from master.devices.hid.node import Node
from master.devices.hid.pid import PidConfig
from master.devices.hid.search import FoundDevice
from studies.hid.virtual.device import VirtualDevice
from studies.kernel.cases import CASES, Case, Shares
from studies.kernel.init import read_words, run_checks, try_check
from studies.kernel.judge import (
    Sent,
    WrongError,
    count_lost_reports,
    format_quantiles,
    match_echoes,
)
from studies.kernel.plugged import Plugged
from teleop.runtime.clock import Grid, pause_garbage_collection

_CONSTANT = 1


def play(node: Node, case: Case) -> None:
    """Write what hid-pidff writes."""
    known = _WRITES.get(case.name)
    if known is None:
        return
    control, gain, creation, load, pool, free = known
    for report in control:
        node.write(bytes(report))
    node.get_feature(pool, 5)
    node.write(bytes(gain))
    node.send_feature(bytes((creation, _CONSTANT, 0, 0)))
    block = node.get_feature(load, 5)[1]
    node.write(bytes((free, block)))


_BOARD = (((0x0C, 0), (0x0C, 0), (0x0C, 1)), (0x0D, 0xFF), 0x11, 0x12, 0x13, 0x0B)
_WRITES = {
    "openffboard": _BOARD,
    "openffboard-wheel": _BOARD,
    "arduino": (((0x0C, 4), (0x0C, 4), (0x0C, 1)), (0x0D, 0xFF), 0x05, 0x06, 0x07, 0x0B),
    "sidewinder": (((0x0C, 4), (0x0C, 4), (0x0C, 1)), (0x0D, 0xFF), 0x05, 0x06, 0x07, 0x0B),
    "rhino": (((112, 4), (112, 4), (112, 2)), (113, 0xFF), 5, 6, 7, 111),
}


# --- the checks, one function each


REPORTS = 1000  # to be read and written, each
RATE_HZ = 1000.0
RATE_MIN_HZ = 950.0
FORGET_MAX_S = 0.250  # after the death of the process that pushed
UNPLUGGED_MAX_S = 0.100
READS_BY_DEVICE = 500
FULL_N = 5.0  # [N] what full scale is taken to be
TRAVEL_M = 0.05  # [m]
_PROBE_SHARE = 0.2
_SETTLE_S = 0.05
_APPEAR_S = 5.0

_REPORT_POWER = ("sidewinder", "rhino")  # of their own accord; OpenFFBoard only when it is asked

Figures = dict[str, str]
Check = Callable[[Case, Plugged], Figures]


def found(case: Case, rig: Plugged) -> Figures:
    """It is listed, bound by the kernel's own driver, and the right one of our drivers fits."""
    start = time.monotonic()
    chosen = _search(case)
    took = time.monotonic() - start
    if chosen.kind != case.driver:
        raise WrongError(f"driver {chosen.kind} was chosen, not {case.driver}")
    bound = Path(f"/sys/class/hidraw/{Path(chosen.item.path).name}/device/driver").resolve().name
    if bound != case.kernel:
        raise WrongError(f"the kernel bound it to {bound}, not {case.kernel}")
    return {"driver": chosen.kind, "kernel": bound, "listed after": _format_ms(took)}


def descriptor(case: Case, rig: Plugged) -> Figures:
    """The node gives the descriptor that the device has."""
    with _open_node(case) as node:
        data = node.read_descriptor()
    if data != case.build_device().descriptor:
        raise WrongError("another descriptor arrived than the device has")
    return {"bytes": str(len(data))}


def beside_kernel(case: Case, rig: Plugged) -> Figures:
    """What the kernel's hid-pidff writes at plug-in leaves no force, and us a device that works."""
    with _open_node(case) as node:
        play(node, case)
    if not case.centres and any(any(push.force) for push in rig.list_pushes()):
        raise WrongError("it pushed before anyone asked for a force")
    return {"hid-pidff": "played"}


def centring(case: Case, rig: Plugged) -> Figures:
    """Its own spring ends when it is opened, and stays away: a moving hand feels nothing."""
    _wait(lambda: any(rig.list_pushes()[-1].force), "it does not centre by itself")
    for start in ("first", "second"):
        with _open_device(case) as hid:
            opened = time.monotonic()
            _read(hid, 10 * _SETTLE_S)
        time.sleep(_SETTLE_S)
        if any(any(push.force) for push in rig.list_pushes() if push.time > opened):
            raise WrongError(f"it pushed by itself after its {start} start")
    return {"moving hand": "feels nothing"}


def actuators(case: Case, rig: Plugged) -> Figures:
    """Power that goes is a fault with that reason; back, it is read again and pushes nothing."""
    with _open_device(case) as hid:
        rig.switch_power(on=True)  # reported: what was never met does not count
        _read(hid, 0.2, case)
        rig.switch_power(on=False)
        _read_until(hid, fails=True, saying="no power")
        rig.switch_power(on=True)
        on = time.monotonic()
        back = _read_until(hid, fails=False) - on
        time.sleep(_SETTLE_S + POST_TIMEOUT_S)
        if any(rig.list_pushes()[-1].force):
            raise WrongError("it pushed by itself when its power was back")
        _read_until(hid, fails=False)  # what came in while nobody read is lost
        _read(hid, _SETTLE_S)
    _demand_silence(rig)
    return {"fault": "no power", "back after": _format_ms(back)}


def signs(case: Case, rig: Plugged) -> Figures:
    """A small force on each axis pushes that axis and no other; which way, is written down."""
    known = ForceSigns()
    seen = []
    line = DeviceConnection(_search(case), PidConfig())
    try:
        for axis, name in enumerate(case.forces):
            force = [0.0] * len(case.forces)
            force[axis] = -_PROBE_SHARE
            _hold(line, tuple(force))
            forces = rig.list_pushes()[-1].force
            seen.append(-round(forces[axis] / abs(forces[axis])) if forces[axis] else 0)
            others = [abs(share) for k, share in enumerate(forces) if k != axis]
            if max(others, default=0.0) > 0.01 * _PROBE_SHARE:
                raise WrongError(f"a force on {name} pushed {forces}")
            known = known.replace_sign(ForceSign(*line.found.pusher, name, seen[-1]))
    finally:
        line.end(1.0)
    if tuple(seen) != case.signs:
        raise WrongError(f"signs {seen}, but the firmware has {case.signs}")
    save(None, known)
    _demand_silence(rig)
    return {name: f"{sign:+d}" for name, sign in zip(case.forces, seen, strict=True)}


def loop(case: Case, rig: Plugged) -> Figures:
    """1000 reports read and decoded, 1000 forces encoded and written, in one loop at 1 kHz."""
    decoded: list[Shares] = []
    sent: list[Sent] = []
    with _open_node(case) as node:
        driver = DRIVERS[case.driver].make(
            _search(case).item, node.read_descriptor(), PidConfig(), None
        )
        driver.begin(node)
        places = [driver.axes.index(name) for name in case.inputs]
        controls = Controls((0.0,) * len(driver.axes), 0, 0)
        written = connection.WriterState()
        work: list[float] = []
        before = len(rig.list_pushes())
        grid = Grid(RATE_HZ, stop=lambda: len(decoded) >= REPORTS <= len(sent))
        with pause_garbage_collection():
            node.drain()
            for tick in grid:
                now = time.monotonic()
                for report in node.drain():
                    last, controls = controls, driver.decode(controls, report)
                    if controls.axes != last.axes:  # a report of the inputs, not of the state
                        decoded.append(tuple(controls.axes[place] for place in places))
                sent.append(Sent(time.monotonic(), case.force(tick.index)))
                reports, written = connection.step(driver, written, sent[-1].force, now)
                for report in reports:
                    node.write(report)
                work.append(time.monotonic() - now)
        time.sleep(_SETTLE_S)
        pushes = rig.list_pushes()[before:]
        for report in driver.silence():
            node.write(report)
    lost = count_lost_reports(case, decoded)
    delays, missed = match_echoes(sent, pushes, case.signs)
    rate = grid.stats.rate_hz
    figures = {"reads": str(len(decoded)), "lost": str(lost), "rate": f"{rate:.0f} Hz"}
    figures["busy"] = f"{1e3 * statistics.median(work):.2f} ms"
    if case.forces:
        figures |= {"forces": str(len(sent)), "unseen": str(missed), **format_quantiles(delays)}
    _demand(rate >= RATE_MIN_HZ, figures, f"below {RATE_MIN_HZ:.0f} Hz")
    _demand(missed == 0, figures, "forces that the device never made")
    _demand(lost == 0, figures, "reports that never arrived")
    _demand_silence(rig)
    return figures


def device(case: Case, rig: Plugged) -> Figures:
    """The same through `HidDevice`: in metres and newtons, with a thread of its own that writes."""
    sent: list[Sent] = []
    read: list[Shares] = []
    with _open_device(case) as hid:
        before = len(rig.list_pushes())
        grid = Grid(RATE_HZ, stop=lambda: len(sent) >= READS_BY_DEVICE)
        with pause_garbage_collection():
            for tick in grid:
                hand = hid.read(tick.index / RATE_HZ)
                read.append(tuple(position / TRAVEL_M for position in hand.position))
                sent.append(Sent(time.monotonic(), case.force(tick.index)))
                hid.write(_to_newtons(case, sent[-1].force))
        time.sleep(2 * POST_TIMEOUT_S)
        pushes = rig.list_pushes()[before:]
    count_lost_reports(case, [now for last, now in pairwise(read) if now != last])
    figures = {"rate": f"{grid.stats.rate_hz:.0f} Hz"}
    if case.forces:
        while_sent = [push for push in pushes if push.time < sent[-1].time + POST_TIMEOUT_S]
        delays, missed = match_echoes(sent, while_sent, (1,) * len(case.forces))
        overtaken = missed / (len(sent) * len(case.forces))
        figures |= {"overtaken": f"{overtaken:.1%}", **format_quantiles(delays)}
        _demand(overtaken < 0.02, figures, "too many forces never reached the device")
        _demand(not any(pushes[-1].force), figures, "nobody wrote any more, and it still pushed")
    _demand(grid.stats.rate_hz >= RATE_MIN_HZ, figures, f"below {RATE_MIN_HZ:.0f} Hz")
    _demand_silence(rig)
    return figures


def replug(case: Case, rig: Plugged) -> Figures:
    """Pulled out, it is missed at once; put in again, it is read again, and pushes nothing."""
    with _open_device(case) as hid:
        _read(hid, 0.1, case)
        out = rig.unplug()
        missed = _read_until(hid, fails=True) - out
        back = rig.plug()
        again = _read_until(hid, fails=False) - back
        opened = time.monotonic()
        time.sleep(_SETTLE_S)
        pushes = [push for push in rig.list_pushes() if push.time > opened or not case.centres]
        if any(any(push.force) for push in pushes) or any(rig.list_pushes()[-1].force):
            raise WrongError("it pushed by itself when it was back")
        figures = {"missed after": _format_ms(missed), "back after": _format_ms(again)}
        if case.forces:
            hid.write(_to_newtons(case, case.force(1)))
            time.sleep(_SETTLE_S / 2)
            _demand(any(rig.list_pushes()[-1].force), figures, "no force after it was back")
    _demand(missed < UNPLUGGED_MAX_S, figures, "unplugging was seen too late")
    _demand_silence(rig)
    return figures


def killed(case: Case, rig: Plugged) -> Figures:
    """The process that pushes is killed: the force ends by itself, by the device's own clock."""
    child = multiprocessing.get_context("fork").Process(target=_push_for_ever, args=(case,))
    child.start()
    _wait(lambda: any(rig.list_pushes()[-1].force), "no force came")
    time.sleep(FORGET_MAX_S)
    if not any(rig.list_pushes()[-1].force):
        raise WrongError("the force ended while the process lived")
    os.kill(child.pid or 0, signal.SIGKILL)
    dead = time.monotonic()
    child.join()
    time.sleep(FORGET_MAX_S + _SETTLE_S)
    last = rig.list_pushes()[-1]
    if any(last.force):
        raise WrongError(f"it still pushes with {last.force}")
    figures = {"force gone after": _format_ms(last.time - dead)}
    _demand(last.time - dead <= FORGET_MAX_S, figures, "too late")
    return figures


def list_checks(case: Case) -> tuple[Check, ...]:
    """Return what is tried on a device, in order."""
    if not case.forces:
        return found, descriptor, loop, device, replug
    usual = signs, loop, device, replug, killed
    if case.driver != "pid":
        return found, descriptor, *usual
    own = (centring,) if case.centres else ()
    state = (actuators,) if case.name in _REPORT_POWER else ()
    return found, descriptor, beside_kernel, *own, *usual, *state


def _push_for_ever(case: Case) -> None:
    force = _to_newtons(case, case.force(1))
    with _open_device(case) as hid:
        for tick in Grid(RATE_HZ, stop=lambda: False):
            hid.read(tick.index / RATE_HZ)
            hid.write(force)


def _search(case: Case) -> FoundDevice:
    """Return the device, once the kernel has it."""
    model = f"{case.build_device().vendor:04x}:{case.build_device().product:04x}"
    end = time.monotonic() + _APPEAR_S
    while True:
        try:
            return search.find_device(model, "auto")
        except DeviceFault as fault:
            if time.monotonic() > end:
                raise WrongError(str(fault)) from fault
            time.sleep(0.01)


@contextmanager
def _open_node(case: Case) -> Iterator[Node]:
    chosen = _search(case)
    with closing(Node(chosen.item.path, str(chosen.item))) as node:
        yield node


def _open_device(case: Case) -> closing[HidDevice]:
    axes = tuple(
        AxisConfig(name=name, travel=TRAVEL_M, force=FULL_N if name in case.forces else 0.0)
        for name in case.inputs
    )
    config = HidConfig(find=_search(case).item.model, axes=axes)
    return closing(HidDevice(config, say=lambda _line: None))


def _to_newtons(case: Case, force: Shares) -> Shares:
    """Return shares for the axes that push as newtons for all."""
    known = dict(zip(case.forces, force, strict=True))
    return tuple(FULL_N * known.get(name, 0.0) for name in case.inputs)


def _hold(line: DeviceConnection, force: Shares) -> None:
    end = time.monotonic() + _SETTLE_S
    while time.monotonic() < end:
        line.post(force)
        time.sleep(0.005)


def _read(hid: HidDevice, span: float, pushed: Case | None = None) -> None:
    """Read a device for a while [s], and write the forces of a case if it is `pushed`."""
    end = time.monotonic() + span
    for tick in Grid(RATE_HZ, stop=lambda: time.monotonic() > end):
        hid.read(tick.index / RATE_HZ)
        if pushed is not None:
            hid.write(_to_newtons(pushed, pushed.force(tick.index)))


def _read_until(hid: HidDevice, *, fails: bool, saying: str = "") -> float:
    """Read until that fails, `saying` why, or works again; return when it did [s]."""
    end = time.monotonic() + _APPEAR_S
    for tick in Grid(RATE_HZ, stop=lambda: time.monotonic() > end):
        try:
            hid.read(tick.index / RATE_HZ)
        except DeviceFault as fault:
            failed = True
            if saying not in str(fault):
                raise WrongError(f"it failed otherwise: {fault}") from fault
        else:
            failed = False
        if failed is fails:
            return time.monotonic()
    raise WrongError("unplugging was never seen" if fails else "it was never found again")


def _wait(true: Callable[[], bool], trouble: str) -> None:
    end = time.monotonic() + _APPEAR_S
    while not true():
        if time.monotonic() > end:
            raise WrongError(trouble)
        time.sleep(0.01)


def _demand_silence(rig: Plugged) -> None:
    time.sleep(_SETTLE_S)
    last, refused = rig.list_pushes()[-1], rig.list_refused()
    if any(last.force):
        raise WrongError(f"closed, it still pushes with {last.force}")
    if refused:
        raise WrongError(f"the device could make nothing of {refused[0].hex(' ')}")


def _demand(held: bool, figures: Figures, trouble: str) -> None:
    if not held:
        raise WrongError(f"{trouble}: {figures}")


def _format_ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"


# --- the guest


def main() -> None:
    """Never returns."""
    run_checks(_try_all)


def _try_all(say: Callable[..., None]) -> None:
    names = read_words("devices")
    for case in CASES:
        if case.name in names:
            _try(case, say)


def _try(case: Case, say: Callable[..., None]) -> None:
    def move_hand(moved: VirtualDevice, n: int) -> None:
        moved.axes[: len(case.inputs)] = case.place_hand(n)

    case.place_hand(0)
    with Plugged(case.build_device(), move_hand) as rig:
        for check in list_checks(case):
            try_check(say, case.name, check, case, rig)
