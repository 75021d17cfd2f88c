"""A rig on CiA 402 drives whose CANopen stack nobody here wrote: what moves, stops, and is said."""

import errno
import os
import re
import signal
import threading
import time
from contextlib import ExitStack, contextmanager
from functools import partial

import can
import canopen
import numpy as np
import pytest
from durand import Variable
from durand.datatypes import DatatypeEnum

from slave import loop
from slave.config import SlaveConfig, TendonConfig
from slave.drivers import driver_table
from slave.drivers.cia402 import bus
from slave.drivers.cia402.config import (
    LOAD_MAX,
    BusConfig,
    Cia402Config,
    compute_bus_load,
    compute_frame_bits,
)
from slave.drivers.cia402.drive import (
    ControlWord,
    DriveState,
    NodeSetup,
    RequestedState,
    decode_drive_state,
    select_control_word,
)
from slave.drivers.cia402.monitor import BusMonitor
from slave.drivers.driver import DriverFault
from slave.process import SlaveProcess
from slave.rig import RigFault
from slave.rigs.hardware import HardwareRig
from slave.warm_up import compile_session
from studies.rigs.models.drives import DISABLED, ENABLED, FAULT, QUICK_STOP, Drives, SlcanAdapter
from studies.rigs.models.line import PseudoPort
from studies.rigs.models.plant import METRES, ZERO, Springs
from teleop.messages.messages import MAX_JOINTS, Command, EmergencyStop, pad_values
from teleop.messages.topics import COMMAND, STOP, Role
from teleop.remote.request_listener import CALL, RESET
from teleop.runtime.clock import EventClock
from teleop.session.state_machine import Reason, State
from tests.drivers.bench import (
    cia402,
    engage,
    follow,
    opened,
    read_for,
    read_some,
    rig_config,
    running,
    wait_until,
)
from tests.tick.memory_link import MemoryLink

SLOW = pytest.mark.slow


@pytest.fixture
def drives():
    port = PseudoPort()
    with running(Drives(SlcanAdapter(port), numbers=(1, 2))) as drives:
        drives.port_name = port.name
        yield drives
    drives.bus.shutdown()


def config_on(drives, **settings):
    return cia402(drives.port_name, **settings)


def opened_on(drives, count=2, **settings):
    return opened(rig_config(config_on(drives, **settings), count=count))


def moving(drives):
    return lambda: all(drive.state == ENABLED for drive in drives.drives)


def test_every_status_word_has_one_state():
    found = {decode_drive_state(word) for word in range(1 << 7)}
    assert found == set(DriveState)
    for state in DriveState:
        assert decode_drive_state(state.value[1] | 0x8600) is state  # other bits do not matter


def test_no_request_ever_resets_a_fault():
    for state in DriveState:
        for requested in RequestedState:
            word = select_control_word(state, requested)
            assert not word & ControlWord.RESET_FAULT
            if state in (DriveState.FAULT, DriveState.FAULT_REACTION, DriveState.NOT_READY):
                assert word == ControlWord.DISABLE_VOLTAGE
            if requested is not RequestedState.MOVE:
                assert word != ControlWord.ENABLE_OPERATION


@pytest.mark.parametrize(
    ("rate_hz", "fits"), [(1000.0, 3), (500.0, 7)]
)  # with a cell at each drive, worst case of bit stuffing
def test_the_bus_carries_as_many_drives_as_its_bits_allow(rate_hz, fits):
    assert compute_frame_bits(8) == 135
    assert compute_bus_load(1e6, rate_hz, fits, fits, fits, wide=False) <= LOAD_MAX
    assert compute_bus_load(1e6, rate_hz, fits + 1, fits + 1, fits + 1, wide=False) > LOAD_MAX


def test_a_bus_that_cannot_carry_the_drives_is_refused_before_it_is_opened():
    config = Cia402Config(bus=BusConfig(channel="none"), rate_hz=1000.0)
    with (
        pytest.raises(RigFault, match=r"the bus would be 10\d% full at 1000 Hz"),
        opened(rig_config(config, count=4)),
    ):
        pass


def test_samples_come_in_order_and_drives_follow_from_where_they_are(drives):
    with opened_on(drives) as rig:
        before = read_some(rig)[-1].proximal_displacement
        assert [drive.state for drive in drives.drives] == [DISABLED, DISABLED]
        engage(rig, moving(drives))
        assert follow(rig, before).proximal_displacement == pytest.approx(before, abs=5e-5)
        sample = follow(rig, before + 0.001)
        assert sample.proximal_tension == pytest.approx([3.0, 3.0], abs=0.3)
        assert np.all(np.diff([sample.time_s for sample in read_some(rig)]) > 0.0)
        # as node 2's boot-up, but with an identifier of 29 bits: not of the drives
        drives.bus.port.write(b"T00000702100\r")
        follow(rig, before + 0.002)


@SLOW
def test_limits_and_watchdog_are_in_the_drive(drives):
    with opened_on(drives, following_error=777, position_max=123_456, watchdog=0.03):
        od = drives.drives[1].od
        assert od.read(0x6065, 0) == 777
        assert od.read(0x607D, 2) == 123_456
        assert od.read(0x1016, 1) == 127 << 16 | 30
        assert (od.read(0x605A, 0), od.read(0x6007, 0)) == (6, 3)
        assert od.read(0x60C2, 1) == 20


@SLOW
def test_a_drive_may_be_guarded_in_place_of_hearing_our_heartbeat(drives):
    with opened_on(drives, error_control="guarding") as rig:
        engage(rig, moving(drives))
        for drive in drives.drives:
            assert drive.patience_s == pytest.approx(0.040)
            assert (drive.od.read(0x1016, 1), drive.od.read(0x1017, 0)) == (0, 0)
    drives.drives[1].guards = False
    with (
        opened_on(drives, error_control="guarding") as rig,
        pytest.raises(RigFault, match="drive 2 does not answer node guarding"),
    ):
        read_for(rig, 5.0)


def test_guarding_takes_its_share_of_the_bus():
    rates = {"rate_hz": 500.0, "bus": BusConfig(channel="none")}
    Cia402Config(**rates).require_load(7, 7, 7)
    with pytest.raises(ValueError, match="the bus would be"):
        Cia402Config(**rates, error_control="guarding").require_load(7, 7, 7)


@pytest.mark.parametrize(
    ("state", "disable_s"), [(ENABLED, 0.2), pytest.param(QUICK_STOP, 0.0, marks=SLOW)]
)
def test_a_drive_that_another_program_left_enabled_does_not_move_in_the_set_up(
    drives, state, disable_s
):
    drive = drives.drives[1]
    drive.od.write(0x6060, 0, 1)  # profile position: it waits for the bit of a new target
    drive.od.write(0x607A, 0, 5000)
    drive.od.write(0x6065, 0, 10_000)
    drive.disable_s = disable_s
    drive._enter(state)
    states = []
    for index in (0x6060, 0x6065, 0x607D):
        subindex = int(index == 0x607D)
        drive.od.download_callbacks[(index, subindex)].add(lambda _: states.append(drive.state))
    with opened_on(drives, following_error=10_000) as rig:
        read_some(rig)
        assert drives.plant.position[1] == ZERO
        assert states == [DISABLED] * 3
        engage(rig, moving(drives))
        assert drives.plant.position[1] == pytest.approx(ZERO, abs=2.0)


@SLOW
def test_a_drive_that_keeps_its_power_is_refused_before_its_mode_is_changed(drives):
    drive = drives.drives[1]
    drive.disable_s = 100.0
    drive._enter(ENABLED)
    said = "drive 2 is still operation enabled .* after disable voltage"
    with pytest.raises(RigFault, match=said), opened_on(drives):
        pass
    assert drive.od.read(0x6060, 0) == 0


@SLOW
def test_a_value_that_the_drive_changes_is_refused(drives):
    od = drives.drives[1].od
    od.set_read_callback(0x6065, 0, lambda: 5)
    with (
        pytest.raises(RigFault, match="drive 2 object 6065:0: set to 2000, reads back 5"),
        opened_on(drives),
    ):
        pass


@SLOW
@pytest.mark.parametrize(("rate_hz", "written"), [(50.0, (20, -3)), (800.0, (125, -5))])
def test_the_interpolation_period_is_that_of_sync(drives, rate_hz, written):
    od = drives.drives[0].od
    with opened_on(drives, count=1, rate_hz=rate_hz):
        assert (od.read(0x60C2, 1), od.read(0x60C2, 2)) == written
    assert written[0] * 10.0 ** written[1] == pytest.approx(1.0 / rate_hz, rel=1e-12)


@pytest.mark.parametrize(("rate_hz", "nearest"), [(300.0, 303.03), (1600.0, 1587.3)])
def test_a_rate_whose_period_no_drive_can_be_told_is_refused_with_the_nearest(rate_hz, nearest):
    with pytest.raises(ValueError, match=r"rate_hz: .*60C2") as refused:
        Cia402Config(rate_hz=rate_hz)
    (said,) = re.findall(r"nearest is (\S+) Hz", str(refused.value))
    assert float(said) == pytest.approx(nearest, rel=1e-5)
    Cia402Config(rate_hz=float(said))  # as it is written


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"velocity_max": 0}, "velocity_max: must be 1 to 2147483647"),
        ({"position_min": -(1 << 31) - 1}, "position_min: must be -2147483648 to 2147483647 count"),
        ({"following_time": float("nan")}, r"following_time: must be 0 to 65\.5 s"),
    ],
)
def test_limits_beyond_their_objects_are_refused_by_the_config(settings, said):
    with pytest.raises(ValueError, match=said):
        Cia402Config(**settings)
    Cia402Config(velocity_max=(1 << 31) - 1, position_min=-(1 << 31), following_time=65.5)


@pytest.mark.parametrize(
    ("size", "value", "signed"),
    [(1, 256, False), (4, -1, False), (4, 1 << 31, True)],
)
def test_a_value_that_does_not_fit_its_object_is_not_sent(size, value, signed):
    network = canopen.Network()  # not connected: whatever is sent raises another error
    set_up = NodeSetup(network, 3, Cia402Config(), BusMonitor(BusConfig()))
    with pytest.raises(DriverFault, match=f"drive 3 object 607F:0: {value} does not fit"):
        set_up.put(0x607F, 0, size, value, signed=signed)


@pytest.mark.parametrize("error_control", ["heartbeat", pytest.param("guarding", marks=SLOW)])
def test_a_killed_driver_leaves_the_drives_to_their_watchdog(drives, error_control):
    with opened_on(drives, error_control=error_control) as rig:
        engage(rig, moving(drives))
        os.kill(rig.buses[0].pid, signal.SIGKILL)
        assert wait_until(lambda: all(drive.state == QUICK_STOP for drive in drives.drives))
    with opened_on(drives) as rig:
        read_some(rig)
        assert not any(drive.state == ENABLED for drive in drives.drives)


@pytest.mark.parametrize("lost", [pytest.param(0, marks=SLOW), 1])
def test_a_target_right_behind_an_emergency_stop_does_not_undo_it(drives, lost):
    for drive in drives.drives:
        drive.lost = lost * [ControlWord.QUICK_STOP]
    with opened_on(drives) as rig:
        start = engage(rig, moving(drives))
        rig.emergency_stop()

        def stopped():
            return all(drive.state == QUICK_STOP for drive in drives.drives)

        read_for(rig, 5.0, start, until=stopped)
        assert stopped()
        engage(rig, moving(drives), start)


class Watched(Springs):
    """Keeps the largest step [m] of a target under power, also from where a motor was without."""

    largest_step, _before = 0.0, ZERO

    def advance(self, time_s, target, powered):
        now = np.where(powered, target, self.position)
        step = float(np.abs(now - self._before).max()) * METRES
        self.largest_step, self._before = max(self.largest_step, step), now
        super().advance(time_s, target, powered)


class Bench:
    """The slave's process on a rig, with a master whose hand moves on and on, in real time."""

    def __init__(self, rig, config, stack):
        roles = (Role.SLAVE, Role.MASTER, Role.LAUNCHER)
        links = [stack.enter_context(MemoryLink(role)) for role in roles]
        for link in links:
            link.meet([other for other in links if other is not link])
        self.link, self.master, self.launcher = links
        self.link.world, self.state, self._commands = self._command, State.READY, 0
        clock = EventClock(1000.0, lambda: False, partial(self.link.wait, COMMAND))
        model = loop.build_rig_model(
            rig.joints, [tendon.build_model() for tendon in config.tendons]
        )
        self.slave, self._ticks = SlaveProcess(config, self.link, rig, model, clock), iter(clock)

    def _command(self):
        time.sleep(1e-3)
        self._commands += 1
        position = pad_values((2e-5 * self._commands,), MAX_JOINTS)
        self.master.publish(COMMAND, Command(state=self.state, position=position))
        self.master.carry(self.link)

    def request(self, action):
        side = {"side": Role.SLAVE, "number": int(self.slave._stops[0])}
        request = EmergencyStop(role=Role.LAUNCHER, action=action, **side)
        self.launcher.publish(STOP, request)
        self.launcher.carry(self.link)

    def run_until(self, condition):
        def ticked():
            self.slave.tick(next(self._ticks))
            return condition()

        assert wait_until(ticked), self.slave.error

    @property
    def side(self):
        return self.slave._outline()


def test_a_drive_that_is_enabled_late_makes_no_step_however_far_the_hand_has_moved(drives):
    # as patient as the drivers here
    config = SlaveConfig(tendons=(TendonConfig(effective_friction=0.8),), sample_timeout=0.5)
    compile_session(config, with_dynamics=False)
    drives.plant = plant = Watched(2)
    drive = drives.drives[0]
    drive.enable_s, rate_hz = 0.5, 100.0
    with opened(rig_config(config_on(drives, rate_hz=rate_hz))) as rig, ExitStack() as stack:
        bench = Bench(rig, config, stack)
        for _ in range(2):  # the second time after an emergency stop
            bench.state = State.READY
            bench.run_until(lambda: bench.side == (State.READY, Reason.NONE))
            bench.state = State.ENGAGED
            goal = plant.position[0] + 0.001 / METRES
            bench.run_until(lambda goal=goal: plant.position[0] > goal)
            assert bench.side.state is State.ENGAGED
            bench.request(CALL)
            bench.run_until(lambda: drive.state == QUICK_STOP)
            assert not rig.follows
            bench.request(RESET)
    assert 0.0 < plant.largest_step < config.gate.speed_max * 2.0 / rate_hz


def test_targets_must_be_near_until_the_drives_follow_and_fresh_to_enable_them(drives):
    with opened_on(drives) as rig:
        start = read_some(rig)[-1].proximal_displacement
        drives.silent = True
        read_for(rig, 0.2)
        with pytest.raises(RigFault, match=r"positions are \d+ ms old, 100 ms at most"):
            rig.write(start)
        drives.silent = False
        drives.drives[1].enable_s = 0.5
        start = read_some(rig)[-1].proximal_displacement
        away = start + np.array([0.0, 0.003])
        rig.write(start)
        with pytest.raises(RigFault, match=r"first target of tendon 2 is 3\.0 mm from"):
            read_for(rig, 5.0, away, until=lambda: rig.follows)
        engage(rig, moving(drives), start)
        follow(rig, away)


def test_a_fault_is_named_and_stays_until_the_operator_resets_it(drives):
    with opened_on(drives) as rig:
        engage(rig, moving(drives))
        drives.drives[1].fail(0x4310)
        with pytest.raises(RigFault, match=r"drive 2: fault: drive or motor too hot \(0x4310\)"):
            read_for(rig, 5.0)
    with pytest.raises(RigFault, match=r"drive 2 has a fault.*teleop rig reset"), opened_on(drives):
        pass
    assert drives.drives[1].state == FAULT
    assert list(driver_table.reset(config_on(drives), (2,))) == ["drive 2: switch on disabled"]
    with opened_on(drives) as rig:
        read_some(rig, 1)
        assert drives.drives[1].state == DISABLED


@pytest.mark.parametrize(
    ("happens", "said"),
    [
        (lambda drive: drive.network.send(0x702, b"\0"), "drive 2 has restarted"),  # boot-up
        pytest.param(
            lambda drive: drive._enter(DISABLED), "drive 2 has left operation by itself", marks=SLOW
        ),
    ],
)
def test_a_drive_that_stops_by_itself_is_a_fault_and_is_not_enabled_again(drives, happens, said):
    with opened_on(drives) as rig:
        start = engage(rig, moving(drives))
        happens(drives.drives[1])
        with pytest.raises(RigFault, match=said):
            read_for(rig, 5.0, start)
    assert not any(drive.state == ENABLED for drive in drives.drives)


@SLOW
def test_a_motor_that_does_not_follow_is_stopped_by_its_drive(drives):
    with opened_on(drives, following_error=50) as rig:
        start = engage(rig, moving(drives))
        drives.drives[0].obeys = False
        with pytest.raises(RigFault, match=r"drive 1: f.*following error"):
            read_for(rig, 5.0, start + 0.001)


@SLOW
def test_a_drive_that_is_not_homed_or_no_drive_is_refused(drives):
    drives.drives[0].homed = 0
    drives.drives[0].od.write(0x6041, 0, DISABLED)
    with pytest.raises(RigFault, match="drive 1 is not homed"), opened_on(drives):
        pass
    with opened_on(drives, homed_bit=None) as rig:
        read_some(rig, 1)
    with (
        pytest.raises(RigFault, match="drive 3 does not answer"),
        opened_on(drives, count=3, homed_bit=None),
    ):
        pass


def test_an_unplugged_adapter_is_named(drives):
    with opened_on(drives) as rig:
        read_some(rig, 1)
        drives.unplug = True
        with pytest.raises(RigFault, match=r"CAN .*unplugged|silent"):
            read_for(rig, 5.0)


def test_read_only_asks_by_sdo_uploads_and_nothing_else(drives):
    frames = []
    for drive in drives.drives:

        def hear(identifier, data, now, hear=drive.hear):
            frames.append((identifier, data[0] if data else None))
            hear(identifier, data, now)

        drive.hear = hear
    rig = HardwareRig(rig_config(config_on(drives), count=2), read_only=True)
    sample = read_some(rig)[-1]
    rig.close()
    assert sample.proximal_tension == pytest.approx([1.0, 1.0], abs=0.1)
    assert sample.proximal_displacement == pytest.approx([0.0, 0.0], abs=5e-5)
    assert set(frames) == {(0x601, 0x40), (0x602, 0x40)}  # initiate upload


CONTROLLERS = [
    (0x80, b"", False),
    pytest.param(0x77F, b"\x05", True, marks=SLOW),
    pytest.param(0x602, bytes.fromhex("4041600000000000"), False, marks=SLOW),
]


@contextmanager
def sent_by_another(drives, identifier, data):
    """Send a frame every 20 ms, as a controller elsewhere on the bus."""
    ended = threading.Event()

    def send():
        while not ended.wait(0.02):
            frame = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
            drives.bus.send(frame)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize(("identifier", "data", "read_only"), CONTROLLERS)
def test_a_bus_with_another_controller_is_refused_before_anything_is_sent(
    drives, identifier, data, read_only
):
    heard = []
    for drive in drives.drives:
        drive.hear = lambda *frame: heard.append(frame)
    with (
        sent_by_another(drives, identifier, data),
        pytest.raises(RigFault, match="another controller is on the bus"),
    ):
        HardwareRig(rig_config(config_on(drives), count=2), read_only)
    assert heard == []


def test_heartbeats_of_nodes_and_their_values_are_no_controller():
    for identifier in (0x701, 0x181, 0x282, 0x81, 0x581):
        frame = can.Message(arbitration_id=identifier, data=b"\x05", is_extended_id=False)
        assert bus.identify_controller_frame(frame, master=127) == ""


@SLOW
@pytest.mark.parametrize(
    ("index", "kind", "value", "said"),
    [
        (0x607E, DatatypeEnum.UNSIGNED8, 0x80, "drive 2 has reversed positions"),
        (0x60B0, DatatypeEnum.INTEGER32, 1024, "drive 2 has an offset of its targets"),
    ],
)
def test_positions_that_another_program_has_shifted_are_refused(drives, index, kind, value, said):
    drives.drives[1].od[index] = Variable(kind, "rw", value)
    with pytest.raises(RigFault, match=f"{said} .object {index:04X}"), opened_on(drives):
        pass


def full_queue(refusals):
    """Return a `send` whose queue is full for so many tries, and what it has sent."""
    sent = []

    def send(message, timeout=None):
        nonlocal refusals
        if refusals > 0:
            refusals -= 1
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)
        sent.append((message, timeout))

    return send, sent


def test_a_frame_waits_for_room_in_the_queue(monkeypatch):
    monkeypatch.setattr(bus, "QUEUE_S", 10.0)
    send, sent = full_queue(refusals=3)
    bus.retry_full_queue(send)("frame")
    assert sent == [("frame", None)]
    with pytest.raises(can.CanOperationError, match="off"):
        bus.retry_full_queue(lambda *_: (_ for _ in ()).throw(can.CanOperationError("off", 100)))(
            ""
        )
