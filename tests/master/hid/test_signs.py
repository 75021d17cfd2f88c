import pytest

from master.devices.hid import force_signs
from master.devices.hid.force_signs import ForceSign, ForceSignKey, ForceSigns
from teleop.errors import UsageError

BOARD = ForceSignKey("1209:ffb0:abc", "pid", "c0ffee")
X = ForceSign(*BOARD, "x", 1)


def test_what_is_written_is_read_and_the_newest_finding_counts(tmp_path):
    path = tmp_path / "below" / "signs.yaml"
    other = ForceSignKey("1209:5968", "pid", "123456")
    known = ForceSigns().having(X).having(ForceSign(*other, "x", -1))
    force_signs.save(path, known)
    assert force_signs.load(path) == known
    assert known.of(other) == {"x": -1}
    turned = known.having(ForceSign(*BOARD, "x", -1)).having(ForceSign(*BOARD, "y", 1))
    assert len(turned.signs) == 3
    assert turned.of(BOARD) == {"x": -1, "y": 1}


@pytest.mark.parametrize(
    "other", [{"device": "1209:ffb0:b"}, {"driver": "ffbeast"}, {"layout": "0ddba11"}]
)
def test_a_sign_is_of_one_device_one_driver_and_one_descriptor(other):
    assert ForceSigns((X,)).of(BOARD._replace(**other)) == {}


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
