"""The sign of a force is found from motion alone, and only where motion tells it."""

import math

import pytest

from master.devices.hid import force_signs
from master.devices.hid.driver import Controls
from master.devices.hid.force_signs import ForceSign, ForceSignKey, ForceSigns
from teleop.errors import UsageError

MOST = force_signs.TEST_FORCES[-1]


class Handle:
    """A handle on an axis: a mass in grease that a motor pushes, in a time of its own."""

    def __init__(self, wired, stiction=0.0, spring=0.0, drift=0.0, full=5.0):
        self.wired, self.stiction, self.spring = wired, stiction, spring
        self.drift, self.full = drift, full
        self.time, self.x, self.share = 0.0, 0.0, 0.0
        self.most, self.moved = 0.0, 0.0

    def read(self, _time_s):
        return Controls((0.3, self.x), 0, 0)

    def post(self, force):
        other, self.share = force
        assert other == 0.0
        self.most = max(self.most, abs(self.share))

    def sleep(self, dt):
        self.time += dt
        push = self.wired * self.share
        drive = math.copysign(max(abs(push) - self.stiction, 0.0), push) * self.full
        self.x += (drive - self.spring * self.x + self.drift) * dt
        self.moved = max(self.moved, abs(self.x))

    def clock(self):
        return self.time

    def find(self):
        return force_signs.find_sign(self, 1, 1, 2, self.clock, self.sleep)


@pytest.mark.parametrize(
    ("wired", "stiction", "spring"),
    [(1, 0.0, 0.0), (-1, 0.08, 3.0), (1, 0.15, 3.0), (-1, 0.15, 0.0)],
)
def test_whichever_way_it_is_wired_the_sign_is_found(wired, stiction, spring):
    handle = Handle(wired, stiction, spring)
    assert handle.find() == wired
    assert handle.share == 0.0


@pytest.mark.parametrize(
    "handle", [Handle(1, stiction=0.5), Handle(1, drift=1.5), Handle(1, full=0)]
)
def test_what_does_not_move_by_the_push_has_no_sign(handle):
    assert handle.find() == 0
    assert handle.share == 0.0


def test_it_is_pushed_no_harder_and_no_further_than_it_takes():
    light = Handle(1)
    light.find()
    assert light.most == force_signs.TEST_FORCES[0]
    assert light.moved < 4.0 * force_signs.MOTION_MIN
    stuck = Handle(1, stiction=1.0)
    stuck.find()
    assert stuck.most == MOST


def test_a_device_that_fails_is_left_without_force():
    handle = Handle(1)

    def fails(dt):
        handle.sleep(dt)
        if handle.share:
            raise OSError

    with pytest.raises(OSError):  # noqa: PT011 - ours
        force_signs.find_sign(handle, 1, 1, 2, handle.clock, fails)
    assert handle.share == 0.0


BOARD = ForceSignKey("1209:ffb0:abc", "pid", "c0ffee")
X = ForceSign(*BOARD, "x", 1)


def test_what_is_written_is_read_and_the_newest_finding_counts(tmp_path):
    path = tmp_path / "below" / "signs.yaml"
    other = ForceSignKey("1209:5968", "pid", "123456")
    known = ForceSigns().replace_sign(X).replace_sign(ForceSign(*other, "x", -1))
    force_signs.save(path, known)
    assert force_signs.load(path) == known
    assert known.find_signs(other) == {"x": -1}
    turned = known.replace_sign(ForceSign(*BOARD, "x", -1)).replace_sign(ForceSign(*BOARD, "y", 1))
    assert len(turned.signs) == 3
    assert turned.find_signs(BOARD) == {"x": -1, "y": 1}


@pytest.mark.parametrize(
    "other", [{"device": "1209:ffb0:b"}, {"driver": "ffbeast"}, {"layout": "0ddba11"}]
)
def test_a_sign_is_of_one_device_one_driver_and_one_descriptor(other):
    assert ForceSigns((X,)).find_signs(BOARD._replace(**other)) == {}


def test_without_a_file_nothing_is_known_but_a_named_one_must_be_there(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert force_signs.load(None) == ForceSigns()
    force_signs.save(None, ForceSigns((X,)))
    assert force_signs.load(None) == ForceSigns((X,))
    assert (tmp_path / "tendon-teleop" / "force-signs.yaml").exists()
    with pytest.raises(UsageError, match=r"nowhere\.yaml: .*`teleop devices test --signs"):
        force_signs.load(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    "text",
    ["signs: [{device: a, driver: b, layout: c, axis: x, sign: 2}]", "sings: []", "signs: 1"],
)
def test_a_file_that_says_anything_else_is_refused_in_a_line(tmp_path, text):
    path = tmp_path / "signs.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"signs\.yaml") as refused:
        force_signs.load(path)
    assert "\n" not in str(refused.value)
