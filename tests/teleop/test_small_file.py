"""A config, a model, a calibration or a key that has no end is refused in one line, and at once."""

import os

import pytest

from slave.calibration import calibration_file
from slave.config import SlaveConfig
from teleop.config import strict_yaml
from teleop.config.loading import load
from teleop.data import model_file
from teleop.errors import UsageError
from teleop.runtime.files import read_small_file
from teleop.security.authority import AUTHORITY, AUTHORITY_KEY, Authority
from teleop.security.key_files import load_certificate, load_key
from teleop.security.revocation import REVOKED, load_revoked

READERS = {
    "config.yaml": lambda path: load(path, SlaveConfig, "slave"),
    "calibration.yaml": calibration_file.load,
    "model.yaml": model_file.load,
    AUTHORITY: load_certificate,
    AUTHORITY_KEY: load_key,
    REVOKED: lambda path: load_revoked(path.parent, Authority.create("of a test").certificate),
}


def make_endless(path):
    path.symlink_to("/dev/zero")
    return "is a pipe or a device; a regular file is needed"


def make_pipe(path):
    os.mkfifo(path, 0o600)
    return "is a pipe or a device; a regular file is needed"


def make_folder(path):
    path.mkdir()
    return "Is a directory"


def make_huge(path):
    path.touch(0o600)
    os.truncate(path, 1 << 40)  # of holes
    return "kB, the bound of such a file"


@pytest.mark.parametrize("make", [make_endless, make_pipe, make_folder, make_huge])
@pytest.mark.parametrize("name", READERS)
def test_what_has_no_end_is_refused_at_once(tmp_path, name, make):
    path = tmp_path / name
    says = make(path)
    with pytest.raises(UsageError) as caught:
        READERS[name](path)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_of_exactly_the_bound_is_read_whole(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_small_file(path, 1000) == b"x" * 1000
    with pytest.raises(UsageError, match="more than 0 kB"):
        read_small_file(path, 999)


def laughs(levels):
    """Return lists of ten, each of aliases of the one before: 10^levels values in all."""
    lines = ["a0: &a0 [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    for level in range(1, levels):
        inner = ", ".join([f"*a{level - 1}"] * 10)
        lines.append(f"a{level}: &a{level} [{inner}]")
    return "\n".join(lines)


def test_aliases_that_multiply_are_refused():
    with pytest.raises(UsageError, match=r"bomb\.yaml, line 5: has more than 100000 values"):
        strict_yaml.parse(laughs(9), "bomb.yaml")
    assert len(strict_yaml.parse(laughs(4), "small.yaml")) == 4


def test_an_alias_of_what_it_is_in_is_refused():
    for text in ("a: &a [*a]", "a: &a {b: *a}", "&a {b: {c: [*a]}}"):
        with pytest.raises(UsageError, match=r"line 1: an alias contains itself"):
            strict_yaml.parse(text, "loop.yaml")


def test_a_bomb_in_an_override_is_refused_too():
    with pytest.raises(UsageError, match="has more than 100000 values"):
        load(None, SlaveConfig, "slave", ["slave.rig={" + laughs(9).replace("\n", ", ") + "}"])
