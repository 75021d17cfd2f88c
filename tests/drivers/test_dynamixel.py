"""A rig on servo models, spoken to by the vendor's SDK: what moves, what stops, what is said."""

import os
import signal

import numpy as np
import pytest

from slave.drivers import configs
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.registers import CURRENT_UNIT
from slave.rig import RigFault
from tests.drivers.bench import (
    dynamixel,
    engage,
    follow,
    opened,
    read_for,
    read_some,
    rig_config,
    wait_until,
)
from tests.drivers.models.plant import NEWTONS
from tests.drivers.models.servos import ERROR, GOAL, WATCHDOG, Servos, positions

SCALE = NEWTONS / CURRENT_UNIT  # [N/A] of the servos' currents


@pytest.fixture
def servos():
    servos = Servos(numbers=(1, 2))
    thread = servos.start()
    yield servos
    servos.ended = True
    thread.join()


def opened_on(servos, **settings):
    config = dynamixel(servos.port.name, wait=0.02, rate_hz=100.0, **settings)
    return opened(rig_config(config, count=2, scale=SCALE, uncertainty=0.5))


def moving(servos):
    return lambda: all(s.moving and s.table[WATCHDOG] for s in servos.servos.values())


def seen_to_move(servos):
    """Return a list that tells, after each write to a servo from now on, whether it moves."""
    seen = []
    for servo in servos.servos.values():

        def write(address, data, servo=servo, take=servo.write):
            error = take(address, data)
            seen.append(servo.moving)
            return error

        servo.write = write
    return seen


def torque(servos):
    return [servo.moving for servo in servos.servos.values()]


def test_what_one_sync_read_brings_fits_the_indirect_addresses():
    assert registers.STATUS_SIZE == len(registers.indirect_addresses()) <= 28
    assert sum(entry.size for entry in registers.STATUS) == registers.STATUS_SIZE


@pytest.mark.slow
def test_samples_come_in_order_and_motors_follow_from_where_they_are(servos):
    with opened_on(servos) as rig:
        start = engage(rig, moving(servos))
        sample = follow(rig, start + 0.001)
        assert sample.proximal_tension == pytest.approx([3.0, 3.0], abs=0.3)
        times = [sample.time_s for sample in read_some(rig)]
        assert np.all(np.diff(times) > 0.0)


def test_nothing_has_torque_before_the_first_target_and_no_old_goal_is_taken(servos):
    with opened_on(servos) as rig:
        before = read_some(rig)[-1].proximal_displacement
        assert torque(servos) == [False, False]
        engage(rig, moving(servos))
        after = follow(rig, before).proximal_displacement
        assert after == pytest.approx(before, abs=5e-5)


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
        assert len(moved) > 20
        assert not any(moved)
        assert [servo.get(GOAL, 4, signed=True) for servo in servos.servos.values()] == goals


def test_servos_are_stopped_where_they_are_when_the_slave_ends(servos):
    with opened_on(servos) as rig:
        start = engage(rig, moving(servos))
        servos.plant.LAG_S = 1e6  # they do not come nearer to their goals
        read_for(rig, 0.2, start + 0.001)
    goals = [servo.get(GOAL, 4, signed=True) for servo in servos.servos.values()]
    assert goals == pytest.approx(positions(servos), abs=3)
    assert wait_until(lambda: all(s.table[WATCHDOG] == 255 for s in servos.servos.values()))


def test_no_servo_ever_has_torque_without_its_watchdog(servos):
    unguarded = []
    for servo in servos.servos.values():

        def write(address, data, servo=servo, take=servo.write):
            error = take(address, data)
            unguarded.append(servo.moving and not servo.table[WATCHDOG])
            return error

        servo.write = write
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        rig.emergency_stop()
        assert wait_until(lambda: torque(servos) == [False, False])
        engage(rig, moving(servos), read_some(rig)[-1].proximal_displacement)
    assert not any(unguarded)


def test_an_emergency_stop_is_torque_off_until_the_next_target(servos):
    with opened_on(servos) as rig:
        start = engage(rig, moving(servos))
        rig.emergency_stop()
        assert wait_until(lambda: torque(servos) == [False, False])
        read_some(rig)
        engage(rig, moving(servos), start)


def test_an_emergency_stop_at_the_end_of_the_slave_is_torque_off_too(servos):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        rig.emergency_stop()
    assert torque(servos) == [False, False]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"error": 5}, "hardware error: input voltage out of range, too hot"),
        ({"error": 64}, "unknown hardware error 64"),
        ({"voltage": 92}, "supply of 9.2 V, must be 10 to 14.8 V"),
        ({"temperature": 81}, "81 deg C, 70 at most"),
        ({}, ""),
    ],
)
def test_a_status_is_told_in_words(values, said):
    status = np.zeros(1, registers.STATUS_DTYPE)
    for name, value in ({"voltage": 120, "temperature": 30} | values).items():
        status[name] = value
    assert said in registers.status_fault(status[0], dynamixel("x"))
    assert bool(registers.status_fault(status[0], dynamixel("x"))) is bool(said)


@pytest.mark.parametrize(
    ("register", "size", "value", "said"),
    [
        (ERROR, 1, 32, "servo 2: hardware error: overload"),
        (WATCHDOG, 1, 255, "servo 2: its bus watchdog stopped it"),
        pytest.param(64, 1, 0, "servo 2: it was restarted or disabled", marks=pytest.mark.slow),
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


@pytest.mark.slow
def test_a_servo_that_is_not_there_or_has_a_fault_is_refused(servos):
    with (
        pytest.raises(RigFault, match="servo 3: no answer at 1000000 baud"),
        opened(rig_config(dynamixel(servos.port.name), count=3, scale=SCALE, uncertainty=0.5)),
    ):
        pass
    servos.servos[1].put(ERROR, 1, 32)
    with pytest.raises(RigFault, match=r"servo 1 .*overload; remove the cause"), opened_on(servos):
        pass
    assert configs.reset(dynamixel(servos.port.name), (1,)) == ["servo 1: restarted"]
    with opened_on(servos) as rig:
        read_some(rig, 1)
        assert torque(servos) == [False, False]


def test_an_unplugged_adapter_is_named(servos):
    with opened_on(servos) as rig:
        engage(rig, moving(servos))
        servos.ended = True
        with pytest.raises(RigFault, match=r"unplugged|no answer"):
            read_for(rig, 5.0)


def test_tensions_from_currents_need_a_stated_uncertainty(servos):
    with pytest.raises(ValueError, match="uncertainty"):
        rig_config(dynamixel(servos.port.name), count=2)
