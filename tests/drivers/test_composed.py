"""Motors of one bus and load cells of another, and settings that cannot be."""

import dataclasses

import numpy as np
import pytest

from slave.config import SlaveConfig
from slave.rig import RigFault
from slave.rigs.hardware import CellConfig, HardwareJointConfig, Transmission, list_cells
from studies.rigs.models.board import Board
from studies.rigs.models.plant import NEWTONS, ZERO
from studies.rigs.models.servos import Servos
from teleop.config.loading import load
from teleop.errors import UsageError
from tests.drivers.bench import (
    dynamixel,
    engage,
    follow,
    microcontroller,
    opened,
    read_for,
    read_some,
    rig_config,
    running,
    tendon,
)

TENDON = "{motor: {id: 1, pulley_radius: 0.01, counts_per_turn: 4096}, cell: {id: 1, scale: 0.001}}"
RIG = (
    "slave.rig={type: hardware, name: x, motors: {type: microcontroller, port: /dev/x}, "
    "joints: [{tendons: [%s]}]}"
)


@pytest.fixture
def buses(library):
    servos = Servos(numbers=(1,))
    board = Board(library, motors=0, cells=1, plant=servos.plant)
    board.plant = Followed(servos)
    with running(servos), running(board):
        yield servos, board


@pytest.fixture
def board(library):
    with running(Board(library, motors=3, cells=3)) as board:
        yield board


class Followed:
    """The cells of a plant that the servos move."""

    def __init__(self, servos):
        self._servos, self.position = servos, np.zeros(1)

    def advance(self, *_):
        pass

    def read_cells(self):
        return self._servos.plant.read_cells()


def test_one_sample_comes_of_both_buses_and_the_error_of_its_time_is_stated(buses):
    servos, board = buses
    motors = dynamixel(servos.port.name, wait=0.02, rate_hz=100.0)
    with opened(rig_config(motors, microcontroller(board.port.name))) as rig:
        start = engage(rig, lambda: servos.servos[1].moving)
        sample = follow(rig, start + 0.001)
        assert sample.proximal_tension == pytest.approx([3.0], abs=0.5)
        assert np.all(np.diff([sample.time_s for sample in read_some(rig)]) > 0.0)
        assert 0.0 < rig.summarise()["alignment_error_ms"] < 1000.0
        board.ended = True
        with pytest.raises(RigFault, match="unplugged"):
            read_for(rig, 5.0)


def test_a_sensing_loop_has_cells_of_its_own_that_two_tendons_may_share(board):
    ends = (CellConfig(id=3, scale=-NEWTONS), CellConfig(id=2, scale=NEWTONS, offset=100.0))
    with pytest.raises(ValueError, match="loop: must have no cell or two"):
        dataclasses.replace(tendon(1, 1), loop=ends[:1])
    for cells in (ends[:1] * 2, (CellConfig(id=1, scale=NEWTONS), ends[1])):
        with pytest.raises(ValueError, match="loop: both cells must have ids of their own"):
            dataclasses.replace(tendon(1, 1), loop=cells)
    a, b = (dataclasses.replace(tendon(k, k), loop=ends) for k in (1, 4))
    assert [cell.id for cell in list_cells((a, b))] == [1, 4, 3, 2]
    config = rig_config(microcontroller(board.port.name))
    config = dataclasses.replace(config, joints=(HardwareJointConfig((a,)),))
    with opened(config) as rig:
        sample = read_some(rig)[-1]
    assert sample.proximal_tension == pytest.approx([1.0], abs=0.1)
    assert sample.loop_moved_tension == pytest.approx([-1.0], abs=0.1)
    assert sample.loop_held_tension == pytest.approx([1.0 - 100.0 * NEWTONS], abs=0.1)


def test_tensions_of_a_loop_from_currents_need_their_uncertainty():
    ends = tuple(CellConfig(id=k, scale=NEWTONS, uncertainty=0.5) for k in (2, 3))
    config = rig_config(dynamixel("/dev/x"), uncertainty=0.5)

    def add_loop(loop):
        joint = HardwareJointConfig((dataclasses.replace(config.tendons[0], loop=loop),))
        return dataclasses.replace(config, joints=(joint,))

    add_loop(ends)
    with pytest.raises(ValueError, match="those of loops"):
        add_loop((ends[0], dataclasses.replace(ends[1], uncertainty=None)))


def test_counts_become_metres_and_newtons_and_targets_the_same_counts_again():
    right = tendon(1, 1)
    left = dataclasses.replace(
        right, motor=dataclasses.replace(right.motor, direction=-1, gear=4.0, zero=-10.0)
    )
    change = Transmission((right, left))
    counts = np.array([ZERO + 4096.0, -10.0 - 4.0 * 4096.0])
    turn = 2.0 * np.pi * 0.010
    assert change.to_displacement(counts) == pytest.approx([turn, turn])
    assert change.to_counts(change.to_displacement(counts)) == pytest.approx(counts)
    assert change.to_tension(np.array([1500.0, -20.0])) == pytest.approx([1.5, -0.02])


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        (RIG % f"{TENDON}, {TENDON}", "slave.rig.joints: motor 1 belongs to two tendons"),
        (
            RIG % TENDON.replace("motor: {id: 1", "motor: {id: 0"),
            "slave.rig.joints: motor 0: must be 1 to 255 on microcontroller",
        ),
        (
            RIG.replace("microcontroller, port: /dev/x", "cia402")
            % TENDON.replace("id: 1", "id: 127"),
            "motor 127: must be 1 to 127 on cia402, and not its master",
        ),
        (RIG % TENDON.replace("0.001", "0"), "cell.scale: 0.0: must not be 0"),
        (RIG % TENDON.replace("0.01,", "-1,"), "pulley_radius: -1.0: must be 0.0001 to 1 m"),
        (RIG.replace("microcontroller", "arduino") % TENDON, "slave.rig.motors.type: 'arduino'"),
        (
            RIG.replace("microcontroller", "ethercat") % TENDON,
            "; EtherCAT, ODrive, moteus, Feetech",
        ),
        (
            RIG.replace("port: /dev/x", "port: x, watchdog: 1") % TENDON,
            "motors.watchdog: 1.0: must be 0.005 to 0.05 s",
        ),
    ],
)
def test_a_mistake_in_the_config_is_one_line_with_its_place(rig, said):
    with pytest.raises(UsageError, match=said.replace("(", r"\(").replace(".", r"\.")):
        load(None, SlaveConfig, "slave", [rig])
