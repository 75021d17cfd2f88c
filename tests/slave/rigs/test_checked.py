"""A rig of another package: what it gets wrong is named, and moves nothing."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from slave.rig import RigFault, RigSample, as_enabling_rig, get_emergency_stop
from slave.rigs import open_rig
from slave.rigs.extension import CheckedRig, RigExtension
from teleop.errors import UsageError
from tests.slave.test_process import FakeRig, StoppableRig, clock, driven

__all__ = ["clock"]  # a fixture: time stands still but for sleeping

TWO = np.array([1.0, 2.0])


class Pair:
    """A joint of two tendons that returns what it is told to."""

    name, tendons, joints, starts_at_zero = "pair", 2, ((0, 1),), True

    def __init__(self, returned):
        self.returned, self.closed = returned, 0

    def read(self, _time_s):
        if isinstance(self.returned, Exception):
            raise self.returned
        return self.returned

    def write(self, _displacement):
        raise ZeroDivisionError("no motor")

    def advance(self): ...

    def summarise(self):
        return {}

    def close(self):
        self.closed += 1


@dataclass(frozen=True)
class PairConfig(RigExtension):
    type: str = "mylab"
    rig: object = None

    def open(self):
        return self.rig


def test_what_is_right_is_passed_on_as_it_is():
    samples = (RigSample(0.0, TWO, None), RigSample(0.0, TWO, TWO, TWO, np.array([1, 2])))
    rig = open_rig(PairConfig(rig=Pair(samples)))
    assert rig.read(0.0) is samples
    missing = (RigSample(1.0, np.array([np.nan, 1.0]), np.array([0.0, np.nan])),)
    assert open_rig(PairConfig(rig=Pair(missing))).read(0.0) is missing
    assert open_rig(PairConfig(rig=Pair(list(samples)))).read(0.0) == samples


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ((RigSample(0.0, TWO[:1], TWO),), r"proximal_tension has shape \(1,\), must be \(2,\)"),
        ((RigSample(0.0, TWO, TWO, 1.0),), "bench_distal_tension is a float, must be an array"),
        ((RigSample(0.0, [1.0, 2.0], TWO),), "proximal_tension is a list, must be an array"),
        ((RigSample(0.0, TWO.astype(str), TWO),), "proximal_tension is an array of <U"),
        ((RigSample(0.0, TWO, None, None, TWO.astype(object)),), "bench_distal_displacement is an"),
        ((RigSample(np.nan, TWO, TWO),), "time_s is nan"),
        ((RigSample(5.0, TWO, TWO), RigSample(4.0, TWO, TWO)), r"time_s is 4\.0 after 5\.0"),
        ((TWO,), "returned an array of float64, must be RigSample"),
        (None, "returned None, must be a tuple of RigSample"),
    ],
)
def test_a_sample_that_is_wrong_is_named_by_field_with_what_it_must_be(returned, said):
    rig = open_rig(PairConfig(rig=Pair(returned)))
    with pytest.raises(RigFault, match=f"^mylab: Pair.read: {said}"):
        rig.read(0.0)


def test_what_its_code_raises_is_a_fault_with_the_place_in_that_code():
    rig = open_rig(PairConfig(rig=Pair(KeyError("cell"))))
    with pytest.raises(RigFault, match=r"mylab: read fails: KeyError: 'cell' \(.*py, line \d+\)"):
        rig.read(0.0)
    with pytest.raises(RigFault, match="mylab: write fails: ZeroDivisionError: no motor"):
        rig.write(TWO)
    rig = open_rig(PairConfig(rig=Pair(RigFault("the amplifier has tripped"))))
    with pytest.raises(RigFault, match=r"^the amplifier has tripped$"):
        rig.read(0.0)


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({"joints": 3}, "Odd: joints 3, must be as in"),
        ({"joints": ((0,),)}, r"joints \(\(0,\),\) of 2 tendons"),
        ({"tendons": "2"}, "Odd: name must be a text, tendons a number"),
        ({"write": property()}, "Odd has no write"),
    ],
)
def test_a_rig_that_is_none_is_named_and_closed_at_opening(attributes, said):
    rig = type("Odd", (Pair,), attributes)(())
    with pytest.raises(UsageError, match=rf"^slave\.rig: mylab: {said}"):
        open_rig(PairConfig(rig=rig))
    assert rig.closed == 1


def test_what_else_a_rig_has_is_passed_on():
    stoppable, plain = StoppableRig(), FakeRig()
    get_emergency_stop(CheckedRig(stoppable, "mylab"))()
    assert stoppable.stops == [0]
    assert get_emergency_stop(CheckedRig(plain, "mylab")) is None
    assert as_enabling_rig(CheckedRig(plain, "mylab")) is None
    plain.follows = False
    assert as_enabling_rig(CheckedRig(plain, "mylab")).follows is False


class Following(FakeRig):
    """Loses its encoder, and with it the answer whether its motor follows, at the 20th read."""

    @property
    def follows(self):
        return self.encoder.is_enabled if self.reads >= 20 else False


@pytest.mark.parametrize("name", ["follows", "emergency_stop", "announce_pause"])
def test_an_attribute_whose_code_fails_is_not_taken_for_absent(name):
    def broken(rig):
        return rig.encoder.is_enabled

    rig = type("Broken", (Pair,), {name: property(broken)})(())
    said = rf"^slave\.rig: mylab: Broken\.{name} fails: AttributeError: .*'encoder'.* \(.*line \d+"
    with pytest.raises(UsageError, match=said):
        open_rig(PairConfig(rig=rig))
    assert rig.closed == 1


def test_an_answer_that_fails_later_ends_the_session_before_a_write():
    rig = Following()
    slave, _, _ = driven(CheckedRig(rig, "mylab"))
    assert "rig: mylab: Following.follows fails: AttributeError" in str(slave.error)
    assert rig.reads == 20


class Failing(FakeRig):
    """Fails in the session and again at its end."""

    def read(self, time_s):
        if self.reads == 20:
            raise RigFault("the amplifier has tripped")
        return super().read(time_s)

    def summarise(self):
        raise KeyError("temperature")

    def close(self):
        raise OSError("no such device")


def test_what_fails_at_the_end_replaces_no_fault_and_no_summary(capsys):
    rig = CheckedRig(Failing(), "mylab")
    slave, _, _ = driven(rig)
    summary = slave.summarise()
    assert str(slave.error) == "rig: the amplifier has tripped"
    assert json.loads(json.dumps(summary.to_json()["rig"]))["error"].startswith(
        "mylab: summarise fails: KeyE"
    )
    rig.close()
    said = capsys.readouterr().err
    assert "WARNING: mylab: summarise fails: KeyError: 'temperature' (" in said
    assert "WARNING: mylab: close fails: OSError: no such device (" in said
    assert "check that its motors are without power" in said


@pytest.mark.parametrize(
    ("returned", "entries"),
    [
        ({"lost": np.int64(2), "rate": np.float32(0.5)}, {"lost": 2, "rate": 0.5}),
        ({"lost": {1, 2}}, None),
        (None, None),
    ],
)
def test_a_summary_can_be_written_as_json(returned, entries):
    rig = type("Told", (Pair,), {"summarise": lambda _: returned})(())
    summary = open_rig(PairConfig(rig=rig)).summarise()
    json.dumps(summary)
    assert summary == entries if entries else "mylab: summarise fails: " in summary["error"]


@dataclass(frozen=True)
class ReadableConfig(PairConfig):
    def open_read_only(self):
        return self.rig


def test_only_a_rig_that_declares_it_is_opened_read_only():
    pair = Pair((RigSample(0.0, TWO, TWO),))
    assert open_rig(ReadableConfig(rig=pair), read_only=True).read(0.0)
    with pytest.raises(
        UsageError, match=r"^slave\.rig: mylab: does not support --read-only"
    ) as got:
        open_rig(PairConfig(rig=pytest.fail), read_only=True)
    assert "\n" not in str(got.value)


class Blind(FakeRig):
    """Its load cell gives no number from the 20th read on."""

    def read(self, time_s):
        (sample,) = super().read(time_s)
        broken = RigSample(time_s, np.array([np.nan]), sample.proximal_displacement)
        return (sample if self.reads < 20 else broken,)


def test_a_reading_that_stays_away_is_named_in_the_fault():
    _, line, _ = driven(Blind(), ticks=400)
    said = "fault: no new samples from the rig: joint 1, tendon a: its tension is nan"
    assert said in line.said()
