"""The procedure on simulated rigs: it sees the housing alone, the bench at the tip is the judge."""

import re

import numpy as np
import pytest

from slave.calibration.procedure_run import CalibrationRefused
from slave.calibration.procedure_state import Phase
from slave.simulation.environment import TissueConfig
from tests.slave.calibration.calibration_bench import (
    GATE,
    KNOWN,
    QUICK,
    RANGE,
    HousingOnly,
    but,
    calibrated,
    effect,
    joint,
    rig_config,
)

RATE = 500.0  # [Hz]
LOOP = (Phase.RELEASE, Phase.PULL)
SOFT = TissueConfig(position=0.005)


class Run:
    """A run of one joint, with the truth beside what the procedure saw."""

    def __init__(self, *joints, **how):
        self.rig = HousingOnly(rig_config(*joints))
        self.record = calibrated(self.rig, rate_hz=RATE, **how).record
        seen = self.rig.seen[-len(self.record.time) :]
        self.tip = np.array([s.bench_distal_displacement for s in seen])
        self.tip_tension = np.array([s.bench_distal_tension for s in seen])

    def rows(self, side, *phases):
        mine = self.record.side[:, 0] == side
        return mine & np.isin(self.record.phase[:, 0], [int(p) for p in phases])


@pytest.fixture(scope="module")
def run():
    return Run(joint())


def phases(record, j=0):
    codes = record.phase[:, j]
    return [Phase(int(c)) for c in codes[np.flatnonzero(np.diff(codes, prepend=-1))]]


def test_it_does_for_both_directions_what_the_paper_does_for_each(run):
    one = [Phase.TAKE_UP, Phase.SEEK, Phase.SLACKEN, *(Phase.RELEASE, Phase.PULL, Phase.RELEASE)]
    assert phases(run.record) == [*one, *one, Phase.TAKE_UP, Phase.DRAG, Phase.SETTLE]


@pytest.fixture(scope="module")
def full():
    return Run(joint(), initialise=but(KNOWN, loops=1))


@pytest.mark.parametrize("side", [0, 1])
def test_in_a_drag_both_tendons_slide_one_way_while_their_tensions_rise_and_fall(full, side):
    rows = np.flatnonzero(full.rows(2 + side, Phase.DRAG))
    rows = rows[len(rows) // 4 :]
    housing = full.record.travel[rows]
    for way in (housing, full.tip[rows]):
        steps = way[25:] - way[:-25]
        assert steps[:, side].min() > 0.0
        assert steps[:, 1 - side].max() < 0.0
    tension = full.record.tension[rows]
    assert 0.8 * KNOWN.tension < tension[:, side].max() < KNOWN.tension
    assert tension[:, 1 - side].max() > 10.0 * KNOWN.keep
    assert tension[-1, side] < 0.3 * tension[:, side].max()


@pytest.mark.parametrize("side", [0, 1])
def test_the_tip_rests_at_its_stop_through_every_loop(run, side):
    in_loop = run.rows(side, Phase.SLACKEN, *LOOP)
    assert np.ptp(run.tip[in_loop, side]) < 1e-9
    assert run.tip[in_loop, side].max() == pytest.approx(RANGE / 2, abs=1e-6)


@pytest.mark.parametrize("side", [0, 1])
def test_the_stop_is_found_from_the_housing_alone(run, side):
    reached = run.tip[:, side] >= RANGE / 2 - 1e-9
    first = int(np.flatnonzero(run.rows(side, Phase.SEEK) & reached)[0])
    late = run.record.stops[0][side].travel - run.record.travel[first, side]
    assert 0.0 <= late < 0.4e-3


@pytest.mark.parametrize("side", [0, 1])
def test_it_pulls_to_the_tension_chosen_and_releases_to_the_low_one(run, side):
    tension = run.record.tension[run.rows(side, *LOOP), side]
    assert QUICK.tension - 0.1 < tension.max() < QUICK.tension * 1.06
    assert tension.min() == pytest.approx(QUICK.low, abs=0.1)


@pytest.mark.parametrize("side", [0, 1])
def test_the_other_tendon_is_slack_during_the_loop_and_hardly_taut_before(run, side):
    assert run.tip_tension[run.rows(side, *LOOP), 1 - side].max() < 0.5  # what was drawn out
    place = run.tip[:, side] / (RANGE / 2)
    moving = run.rows(side, Phase.SEEK) & (place > 0.2) & (place < 0.8)
    assert run.record.tension[moving, 1 - side].max() < 2.0 * QUICK.keep
    assert np.median(run.record.tension[moving, 1 - side]) > 0.2 * QUICK.keep


def test_all_that_is_written_is_within_the_gates_limits(run):
    written = np.array(run.rig.written)
    assert written.min() >= GATE.displacement_min
    assert written.max() <= GATE.displacement_max
    assert np.abs(np.diff(written, axis=0)).max() <= GATE.speed_max / RATE + 1e-12


@pytest.mark.slow
def test_the_quick_form_takes_less_than_20_s_of_rig_time():
    long = joint(body={"stops": (-RANGE, RANGE)})
    record = calibrated(rig_config(long), rate_hz=RATE).record
    assert record.time[-1] - record.time[0] < 20.0


def test_a_return_spring_does_in_place_of_the_other_tendon():
    run = Run(joint(tendons=1, body={"spring": 200.0, "pretension": 1.0}))
    assert phases(run.record) == [
        *(Phase.TAKE_UP, Phase.SEEK, Phase.RELEASE, Phase.PULL, Phase.RELEASE),
        *(Phase.RETURN, Phase.SETTLE),
    ]
    assert run.record.tension[-1, 0] < 2.0


def test_a_joint_that_starts_at_its_stop_is_calibrated_too():
    record = calibrated(rig_config(joint(body={"stops": (-RANGE, 1e-6)})), rate_hz=RATE).record
    assert [len(stops) for stops in record.stops] == [2]


# What is refused: one line each, with the joint, what was seen and a remedy.

REFUSALS = {
    "no stop": (
        {"a": joint(body={"stops": (-0.5, 0.5)})},
        r"joint 1, tendon [ab]: no stop found before slave.gate.displacement_m",
    ),
    "no stop in reach": (
        {"a": joint(body={"stops": (-0.5, 0.5)}), "initialise": but(QUICK, travel_max=0.02)},
        r"joint 1, tendon a: no stop within 20 mm",
    ),
    "soft tissue": ({"a": joint(environment=SOFT)}, r"joint 1, tendon a: .*something soft"),
    "slack": (
        {"a": joint(), "effects": (effect("slack", length=0.007, tendon="b"),)},
        r"joint 1, tendon b: \d\.\d mm had to be wound in .*slack_max",
    ),
    "a broken tendon": (
        {"a": joint(), "effects": (effect("broken_tendon", tendon="b"),)},
        r"joint 1, tendon b: .*broken",
    ),
    "a tendon that breaks": (
        {"a": joint(), "effects": (effect("broken_tendon", tendon="a", start=3.0),)},
        r"joint 1, tendon a: .*slipped or broke",
    ),
    "too little range": (
        {"a": joint(body={"friction": 6.0})},
        r"joint 1, tendon a: 2\d\.\d N were reached before or just after the stop",
    ),
    "a cell stuck at a tension": (
        {"a": joint(body={"pretension": 5.0}), "effects": (effect("stuck_cell", tendon="a"),)},
        r"joint 1, tendon a: still \d\.\d\d N after paying out 5\.\d mm; .*stuck",
    ),
    "a stuck cell": (
        {"a": joint(), "effects": (effect("stuck_cell", tendon="a"),)},
        r"joint 1, tendon a: .*load cell",
    ),
}


ALIKE = {
    *("no stop in reach", "a stuck cell", "too little range", "a cell stuck at a tension"),
}
CASES = [pytest.param(case, marks=[pytest.mark.slow] * (case in ALIKE)) for case in REFUSALS]


@pytest.mark.parametrize("case", CASES)
def test_it_refuses(case):
    what, said = REFUSALS[case]
    what = dict(what)
    rig = HousingOnly(rig_config(what.pop("a"), effects=what.pop("effects", ())))
    with pytest.raises(CalibrationRefused) as refused:
        calibrated(rig, rate_hz=RATE, **what)
    text = str(refused.value)
    assert re.search(said, text)
    assert "\n" not in text


def test_it_ends_in_the_middle_with_tendons_just_taut(run):
    assert run.tip[-1, 0] == pytest.approx(0.0, abs=0.05 * RANGE)
    assert run.record.tension[-1] == pytest.approx([QUICK.take_up] * 2, abs=0.3)
