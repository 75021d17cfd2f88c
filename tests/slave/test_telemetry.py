"""What the slave tells listeners: each state of the session once, with its place."""

import pytest
from slave.housekeeping import Housekeeping, calibrating

from slave import housekeeping, loop
from slave.calibration.memory import Phase
from slave.calibration.run import Progress
from slave.tendon_config import TendonConfig
from slave.watch import Finding
from teleop.session import Reason, Session, State

JOINTS = ((0, 1), (2,))
KNOWN = loop.know(JOINTS, [TendonConfig(effective_friction=0.8).model()] * 3)
BROKEN = Session(State.FAULT, Reason.TENDON_BROKEN)
NAMED = f"fault: {Reason.TENDON_BROKEN.text}: joint 1, tendon b"


class Silent:
    def publish(self, *_):
        pass


@pytest.fixture
def said(monkeypatch):
    lines = []
    monkeypatch.setattr(housekeeping, "tell", lambda *words: lines.append(words[-1]))
    return lines


def found(tendon):
    return Finding(Reason.TENDON_BROKEN, tendon)


def test_a_fault_keeps_the_place_where_it_began_and_is_told_once(said):
    memory = loop.start(KNOWN, True)
    tell = Housekeeping(Silent(), KNOWN)
    for finding in (found(1), None, found(1), found(2), None):
        tell(0.0, memory._replace(session=BROKEN, found=finding))
        assert tell.detail == "joint 1, tendon b"
    assert said == [NAMED]


def test_a_fault_that_comes_again_is_told_again_and_where(said):
    memory = loop.start(KNOWN, True)
    tell = Housekeeping(Silent(), KNOWN)
    ready = Session(State.READY, Reason.RELEASED)
    for side, finding in ((BROKEN, found(1)), (ready, None), (BROKEN, found(2))):
        tell(0.0, memory._replace(session=side, found=finding))
    assert said[0] == NAMED
    assert said[2] == f"fault: {Reason.TENDON_BROKEN.text}: joint 2, tendon a"


def test_while_not_usable_every_new_reason_is_told(said):
    tell = Housekeeping(Silent(), KNOWN)
    for why in ("no sample yet", "no sample yet", "no calibration"):
        tell(0.0, loop.start(KNOWN, True)._replace(hindrance=why))
    assert [line.split(": ")[-1] for line in said] == ["no sample yet", "no calibration"]


def test_a_calibration_says_where_it_is_now_and_then(capsys):
    class Arm:
        name, joints = "arm", JOINTS

    show = calibrating(Arm())
    for tick in range(5000):
        show(Progress(tick * 1e-3, 1, Phase.PULL, 3, tick / 5000, (12.34, -0.001)))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3  # at 0, 2 and 4 s
    assert lines[1] == "calibrating arm: 40%, joint 1, tendon b: pulling, 12.3 and 0.0 N"
