"""The Teensy's sketch on a stub of the Arduino core: its converter, its loops, its watchdog."""

import shutil

import numpy as np
import pytest

from slave.drivers.microcontroller import frames
from slave.drivers.microcontroller.frames import BoardFlags, FrameReader, FrameType
from studies.rigs.models.board import COMPILER
from studies.rigs.models.sketch import Sketch, compile_sketch

MOTOR = (22, 14, 15)  # pins of motor 1: power, forward, backward
ENCODER = 2  # its first pin


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if COMPILER is None:
        pytest.skip("no C++ compiler, so the sketch is not compiled")
    return compile_sketch(tmp_path_factory.mktemp("sketch"))


@pytest.fixture
def sketch(library, tmp_path):
    """Return a board at power on: each has globals of its own, so each is a library of its own."""
    return Sketch(shutil.copy(library, tmp_path / "sketch.so"))


def states(data):
    found = [frame for frame in FrameReader().feed(data) if frame.kind == FrameType.STATE]
    return [frames.parse_state(frame.body) for frame in found]


def targets(sequence, target, enabled=True):
    return frames.encode(FrameType.SET, sequence, 0, frames.pack_targets((target, target), enabled))


def test_each_cell_has_the_value_of_its_own_input(sketch):
    for pin, counts in enumerate((1000, -500, -70_000, 8)):
        sketch.lib.sketch_set_input(pin, counts)
    sketch.lib.sketch_setup()
    last = states(sketch.run(0.05))[-1]
    assert last.cell == (1500, -70_008)
    assert not last.flags & BoardFlags.CELL_FAULT
    for pin, counts in enumerate((-8_388_607, 0, 3, 3)):
        sketch.lib.sketch_set_input(pin, counts)
    assert states(sketch.run(0.01))[-1].cell == (-8_388_607, 0)


def test_the_converter_is_set_up_and_addressed_as_its_data_sheet_asks(sketch):
    sketch.lib.sketch_setup()
    sketch.run(0.1)
    status, control, rate = (sketch.lib.sketch_register(k) for k in (0, 2, 3))
    assert status & 0x0F == 0b0110  # it calibrates itself, its buffer is on
    assert control & 0b111 == 6  # gain 64
    assert rate == 0xF0  # 30 kSPS
    assert sketch.lib.sketch_misuse() == 0
    assert sketch.lib.sketch_violations() == 0


def test_a_thousand_states_come_each_second_with_a_reading_of_their_own(sketch):
    sketch.lib.sketch_setup()
    sketch.run(0.02)
    cells = []
    for k in range(200):
        sketch.lib.sketch_set_input(0, k)
        cells += [state.cell[0] for state in states(sketch.run(0.001))]
    assert len(cells) == pytest.approx(200, abs=2)
    assert np.diff(cells).max() <= 2  # no reading is older than two milliseconds


def test_without_a_converter_it_says_so(sketch):
    sketch.lib.sketch_setup()
    sketch.run(0.05)
    sketch.lib.sketch_unplug_converter()
    assert states(sketch.run(0.05))[-1].flags & BoardFlags.CELL_FAULT


def test_a_motor_is_driven_towards_its_target_and_off_without_one(sketch):
    def power():
        return sketch.lib.sketch_power(*MOTOR)

    sketch.lib.sketch_set_encoder(ENCODER, 100)
    sketch.lib.sketch_setup()
    sketch.run(0.01)
    assert power() == 0
    sketch.receive(targets(0, 0, enabled=False))
    for target, sign in ((200, 1), (0, -1), (100, 0)):
        sketch.receive(targets(1, target))
        sketch.run(0.01)
        assert np.sign(power()) == sign
    assert states(sketch.run(0.01))[-1].position[0] == 100
    sketch.receive(targets(2, 1_000_000))
    sketch.run(0.01)
    assert power() == 127  # half of its power at most
    sketch.run(0.028)
    assert power() == 127
    sketch.run(0.004)
    assert power() == 0
    assert states(sketch.run(0.002))[-1].flags & BoardFlags.WATCHDOG


def test_a_computer_that_does_not_read_does_not_hold_up_the_watchdog(sketch):
    sketch.lib.sketch_setup()
    sketch.receive(targets(0, 0, enabled=False))
    sketch.receive(targets(1, 1_000_000))
    before_us = sketch.lib.sketch_now_us()
    for _ in range(60):  # nothing is taken from its buffer
        sketch.lib.sketch_run(10_000)
    assert sketch.lib.sketch_now_us() - before_us < 610_000
    assert sketch.lib.sketch_power(*MOTOR) == 0
