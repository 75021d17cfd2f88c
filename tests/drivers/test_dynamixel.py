"""A rig on servo models, spoken to by the vendor's SDK: what moves, what stops, what is said."""

import contextlib
import os
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from slave.drivers import driver_table
from slave.drivers.driver import Channels, DriverFault
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.bring_up import DynamixelReader
from slave.drivers.dynamixel.registers import CURRENT_UNIT
from slave.rig import RigFault
from slave.rigs.hardware import HardwareRig
from studies.rigs.models.plant import NEWTONS, ZERO
from studies.rigs.models.servos import (
    ACCELERATION,
    CURRENT_LIMIT,
    DRIVE_MODE,
    ERROR,
    GOAL,
    GOAL_CURRENT,
    HOMING_OFFSET,
    OPERATING_MODE,
    PING,
    READ,
    REVERSE,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP,
    STATUS_RETURN,
    SYNC_READ,
    TIME_BASED,
    TORQUE,
    TORQUE_BY_GOAL,
    WATCHDOG,
    Servos,
    read_positions,
)
from tests.drivers.bench import (
    LIMIT_S,
    dynamixel,
    engage,
    follow,
    opened,
    read_for,
    read_some,
    rig_config,
    running,
    wait_until,
)

SCALE = NEWTONS / CURRENT_UNIT  # [N/A] of the servos' currents


@pytest.fixture
def servos():
    with running(Servos(numbers=(1, 2))) as servos:
        yield servos


def config_on(servos, **settings):
    config = dynamixel(servos.port.name, wait=0.02, rate_hz=100.0, **settings)
    return rig_config(config, count=2, scale=SCALE, uncertainty=0.5)


def opened_on(servos, **settings):
    return opened(config_on(servos, **settings))


def moving(servos):
    return lambda: all(s.moving and s.table[WATCHDOG] for s in servos.servos.values())


def seen_to_move(servos):
    """Return a list that tells of each write to a servo: whether it moves, and has a watchdog."""
    seen = []
    for servo in servos.servos.values():

        def write(address, data, servo=servo, take=servo.write):
            error = take(address, data)
            seen.append((servo.moving, bool(servo.table[WATCHDOG])))
            return error

        servo.write = write
    return seen


def torque(servos):
    return [servo.moving for servo in servos.servos.values()]


def test_no_servo_has_torque_before_the_first_target_without_its_watchdog_or_after_a_stop(servos):
    moved = seen_to_move(servos)
    with opened_on(servos) as rig:
        before = read_some(rig)[-1].proximal_displacement
        assert torque(servos) == [False, False]
        engage(rig, moving(servos))
        after = follow(rig, before).proximal_displacement  # and no old goal is taken
        assert after == pytest.approx(before, abs=5e-5)
        sample = follow(rig, before + 0.001)
        assert sample.proximal_tension == pytest.approx([3.0, 3.0], abs=0.3)
        rig.emergency_stop()
        assert wait_until(lambda: torque(servos) == [False, False])
        here = read_some(rig)[-1].proximal_displacement
        assert torque(servos) == [False, False]
        engage(rig, moving(servos), here)
    assert any(moves for moves, _ in moved)
    assert all(has_watchdog for moves, has_watchdog in moved if moves)


def test_lost_goals_do_not_let_a_servo_jump_to_an_old_one(servos):
    for servo in servos.servos.values():  # goals are refused: all that is not read-only is taken
        take = servo.write
        servo.write = lambda address, data, take=take: 7 if address == GOAL else take(address, data)
    with opened_on(servos) as rig:
        with pytest.raises(RigFault, match="do not enable their torque"):
            engage(rig, moving(servos))
        assert torque(servos) == [False, False]


def test_a_killed_driver_leaves_the_servos_to_their_watchdogs(servos):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        os.kill(rig.buses[0].pid, signal.SIGKILL)
        assert wait_until(lambda: all(s.table[WATCHDOG] == 255 for s in servos.servos.values()))
    goals = [servo.get(GOAL, 4, signed=True) for servo in servos.servos.values()]
    moved = seen_to_move(servos)
    with opened_on(servos) as rig:
        read_some(rig)
        assert torque(servos) == [False, False]
        assert len(moved) > 10
        assert not any(moves for moves, _ in moved)
        assert [servo.get(GOAL, 4, signed=True) for servo in servos.servos.values()] == goals


def test_servos_are_stopped_where_they_are_when_the_slave_ends(servos):
    with opened_on(servos) as rig:
        start = engage(rig, moving(servos))
        servos.plant.LAG_S = 1e6  # they do not come nearer to their goals
        read_for(rig, 0.2, start + 0.001)
    goals = [servo.get(GOAL, 4, signed=True) for servo in servos.servos.values()]
    assert goals == pytest.approx(read_positions(servos), abs=3)
    assert wait_until(lambda: all(s.table[WATCHDOG] == 255 for s in servos.servos.values()))


def test_an_emergency_stop_at_the_end_of_the_slave_is_torque_off_too(servos):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        rig.emergency_stop()
    assert torque(servos) == [False, False]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"error": 5}, "hardware error: input voltage out of range, too hot"),
        ({"voltage": 92}, "supply of 9.2 V, must be 10 to 14.8 V (voltage)"),
        ({"temperature": 81}, "81 deg C, 70 at most"),
        ({}, ""),
    ],
)
def test_a_status_is_told_in_words(values, said):
    status = np.zeros(1, registers.STATUS_DTYPE)
    for name, value in ({"voltage": 120, "temperature": 30} | values).items():
        status[name] = value
    assert said in registers.find_status_fault(status[0], dynamixel("x"))
    assert bool(registers.find_status_fault(status[0], dynamixel("x"))) is bool(said)


@pytest.mark.parametrize(
    ("register", "size", "value", "said"),
    [
        (
            ERROR,
            1,
            32,
            "servo 2: hardware error: overload; remove the cause, then `teleop rig reset`",
        ),
        (WATCHDOG, 1, 255, "servo 2: its bus watchdog stopped it"),
    ],
)
def test_a_failure_of_a_servo_is_named(servos, register, size, value, said):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        servos.servos[2].put(register, size, value)
        with pytest.raises(RigFault, match=said):
            read_for(rig, 5.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lose", "damage"])
def test_some_bad_answers_cost_their_samples_and_many_are_a_fault(servos, name):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        setattr(servos, name, 3)
        read_some(rig)
        setattr(servos, name, 100_000)
        with pytest.raises(RigFault, match="no answer" if name == "lose" else "answer for"):
            read_for(rig, 5.0)


def test_an_unplugged_adapter_is_named(servos):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        servos.ended = True
        with pytest.raises(RigFault, match=r"unplugged|no answer"):
            read_for(rig, 5.0)


def test_tensions_from_currents_need_a_stated_uncertainty(servos):
    with pytest.raises(ValueError, match="uncertainty"):
        rig_config(dynamixel(servos.port.name), count=2)


@pytest.mark.parametrize(
    ("register", "size", "value", "said", "read_only"),
    [
        (HOMING_OFFSET, 4, -77, "servo 2: Homing Offset is -77 counts, must be 0", True),
        (DRIVE_MODE, 1, REVERSE, "servo 2: Drive Mode is reverse, must be normal", False),
    ],
)
def test_positions_that_count_otherwise_are_refused_with_the_torque_as_it_is(
    servos, register, size, value, said, read_only
):
    servos.servos[2].put(register, size, value)
    servos.servos[2].put(GOAL, 4, int(ZERO))
    servos.servos[2].put(TORQUE, 1, 1)
    with pytest.raises(RigFault, match=said):
        HardwareRig(config_on(servos), read_only)
    assert servos.servos[2].table[TORQUE] == 1
    assert servos.servos[2].get(register, size, signed=value < 0) == value


def test_settings_of_other_programs_are_set_before_the_torque_and_told(servos):
    servo = servos.servos[2]
    left = {DRIVE_MODE: TIME_BASED | TORQUE_BY_GOAL, SECONDARY_ID: 1, STATUS_RETURN: 0, STARTUP: 3}
    left[SHUTDOWN] = 1  # at a wrong voltage only
    for register, value in left.items():
        servo.put(register, 1, value)
    servo.put(ACCELERATION, 4, 900)
    moved = seen_to_move(servos)
    with opened_on(servos) as rig:
        assert torque(servos) == [False, False]
        found = [servo.get(a, 1) for a in left]
        assert (found, servo.get(ACCELERATION, 4)) == ([0, 255, 2, 0, 0x35], 0)
        engage(rig, moving(servos))
    said = rig.summarise()["motors_settings"]
    assert "servo 2: Drive Mode was 12, set to 0" in said
    assert "servo 2: Secondary ID was 1, set to 255" in said
    assert "servo 2: Startup Configuration was 3, set to 0" in said
    assert "servo 2: Shutdown was 1, set to 53" in said
    assert all(has_watchdog for moves, has_watchdog in moved if moves)


def test_the_current_limit_holds_against_a_load(servos):
    limit = 3.2  # [A], of 2.69 A at rest and 8.1 A at the target
    with opened_on(servos, current_limit=limit) as rig:
        start = engage(rig, moving(servos))
        target = start + 0.001
        samples = read_for(
            rig, LIMIT_S, target, until=lambda: min(servos.plant.position) > ZERO + 5
        )
        samples += read_for(rig, 0.5, target)
        assert torque(servos) == [True, True]
    current = np.array([sample.proximal_tension for sample in samples]) / SCALE
    assert np.all(current[-1] > 0.95 * limit)
    assert np.all(current <= limit)
    with opened_on(servos) as rig:  # without a limit they arrive
        engage(rig, moving(servos))
        assert np.all(follow(rig, target).proximal_tension / SCALE > 2.0 * limit)


@pytest.mark.parametrize(
    ("model", "counts"), [pytest.param(1020, 185, marks=pytest.mark.slow), (1200, 500)]
)  # XM430-W350, XL330-M288: 2.69 and 1 mA
def test_the_current_limit_is_set_in_the_unit_of_the_model(servos, model, counts):
    servo = servos.servos[2]
    servo.put(0, 2, model)
    without_torque = []
    take = servo.write

    def write(address, data):
        if address in (OPERATING_MODE, CURRENT_LIMIT, GOAL_CURRENT):
            without_torque.append((address, not servo.table[TORQUE]))
        return take(address, data)

    servo.write = write
    with opened_on(servos, current_limit=0.5) as rig:
        assert servo.table[OPERATING_MODE] == 5
        assert (servo.get(CURRENT_LIMIT, 2), servo.get(GOAL_CURRENT, 2)) == (counts, counts)
        sample = read_some(rig)[-1]  # an X330 servo shows its status at another address
    assert sample.proximal_displacement == pytest.approx([0.0, 0.0], abs=5e-5)
    assert sample.proximal_tension == pytest.approx([0.5 * SCALE] * 2, rel=0.01)
    order = [(address, True) for address in (OPERATING_MODE, CURRENT_LIMIT, GOAL_CURRENT)]
    assert without_torque == order


@pytest.mark.parametrize(
    ("model", "read_only"), [(1060, False), pytest.param(1999, True, marks=pytest.mark.slow)]
)  # XL430-W250, unknown
def test_a_model_without_current_limits_none_and_is_no_cell(servos, model, read_only):
    servos.servos[2].put(0, 2, model)
    config = dynamixel(servos.port.name, current_limit=0.5)
    for cells, said in (
        ((), f"servo 2: model {model} has no current-based position mode.*current_limit to null"),
        ((2,), f"servo 2: model {model} measures no current known to this driver.*slave.rig.cells"),
    ):
        driver = driver_table.open_driver(config, Channels((2,), cells, read_only))
        with pytest.raises(DriverFault, match=said), contextlib.closing(driver):
            driver.start()
    assert servos.servos[2].table[OPERATING_MODE] == 3
    config = dynamixel(servos.port.name)  # without a limit
    with contextlib.closing(driver_table.open_driver(config, Channels((2,), (1,)))) as driver:
        driver.start()
    assert servos.servos[2].table[OPERATING_MODE] == 4


@pytest.mark.parametrize("read_only", [False, True])
def test_a_servo_of_another_control_table_is_refused_before_anything_is_written(
    servos, monkeypatch, read_only
):
    servos.servos[2].put(0, 2, 350)  # XL-320
    for servo in servos.servos.values():
        servo.write = lambda address, _data: pytest.fail(f"written at {address}")
    config = dynamixel(servos.port.name)
    driver = driver_table.open_driver(config, Channels((2,), (), read_only))
    said = "servo 2: model 350 has another control table than the X series"
    with pytest.raises(DriverFault, match=said), contextlib.closing(driver):
        driver.start()
    monkeypatch.setattr(registers, "BAUD_RATES", ())
    first, second = driver_table.scan(config)
    assert first == "servo 1: model 1020 at 1000000 baud"
    assert second == "servo 2: model 350 at 1000000 baud; not of the X series: no driver"


def test_read_only_asks_and_writes_nothing(servos):
    for servo in servos.servos.values():
        servo.put(GOAL, 4, int(ZERO))
        servo.put(TORQUE, 1, 1)
        servo.put(DRIVE_MODE, 1, TIME_BASED)
        servo.write = lambda address, _data: pytest.fail(f"written at {address}")
    goals = [servo.get(GOAL, 4) for servo in servos.servos.values()]
    rig = HardwareRig(config_on(servos), read_only=True)
    sample = read_some(rig)[-1]
    rig.close()
    assert sample.proximal_tension == pytest.approx([1.0, 1.0], abs=0.1)
    assert sample.proximal_displacement == pytest.approx([0.0, 0.0], abs=5e-5)
    assert servos.kinds == {PING, READ, SYNC_READ}
    assert [servo.get(GOAL, 4) for servo in servos.servos.values()] == goals
    assert "servo 1: Drive Mode is 4, a session sets 0" in rig.summarise()["motors_settings"]


def test_a_second_program_is_refused_and_the_first_goes_on(servos):
    config = dynamixel(servos.port.name)
    with opened_on(servos) as rig, ThreadPoolExecutor(1) as second:
        start = engage(rig, moving(servos))
        for program in (
            lambda: HardwareRig(config_on(servos)),
            lambda: HardwareRig(config_on(servos), read_only=True),
            lambda: list(driver_table.scan(config)),
            lambda: list(driver_table.reset(config, (1,))),
        ):
            tried = second.submit(program)
            read_for(rig, LIMIT_S, start, until=tried.done)
            assert f"in use by process {os.getpid()} (" in str(tried.exception(LIMIT_S))
        assert torque(servos) == [True, True]
        follow(rig, start + 0.001)


class Twins(Servos):
    """Two servos of one number: both answer at once, and their bits are mixed on the line."""

    def _obey(self, packet, now):
        sent, write = [], self.port.write
        self.port.write = sent.append
        super()._obey(packet, now)
        self.port.write = write
        answer = b"".join(sent)
        write(answer[:9] + bytes(byte & 0xA5 for byte in answer[9:]))


def test_two_servos_of_one_number_are_named():
    with (
        running(Twins(numbers=(2,))) as twins,
        pytest.raises(DriverFault, match=r"servo 2: damaged .*; two servos of this number\?"),
        contextlib.closing(
            DynamixelReader(dynamixel(twins.port.name), Channels((2,), (), True))
        ) as reader,
    ):
        reader.start()


def test_a_servo_that_is_not_there_is_named_once_the_others_are_reset(servos):
    lines = driver_table.reset(dynamixel(servos.port.name), (1, 7))
    assert next(lines) == "servo 1: restarted"
    with pytest.raises(DriverFault, match="not reset: servo 7: no answer"):
        next(lines)
