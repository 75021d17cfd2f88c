"""The folders of a user: as XDG names them, absolute, or a line that says what to set."""

import pwd
from pathlib import Path

import pytest

from master.devices.hid import force_signs
from teleop.security.credentials import find_local_folder
from teleop.view.command import find_log_path

PLACES = {
    "XDG_STATE_HOME": (find_local_folder, lambda: find_log_path("a")),
    "XDG_CONFIG_HOME": (force_signs.get_default_path,),
}


@pytest.fixture
def environment(monkeypatch, tmp_path):
    for variable in PLACES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return monkeypatch


@pytest.mark.parametrize("variable", PLACES)
def test_a_variable_goes_before_the_home_folder(environment, tmp_path, variable):
    for place in PLACES[variable]:
        assert tmp_path in place().parents
    environment.setenv(variable, "/elsewhere")
    for place in PLACES[variable]:
        assert Path("/elsewhere") in place().parents


def test_a_relative_one_is_refused_and_nothing_made(environment, tmp_path, refused):
    environment.chdir(tmp_path)
    environment.setenv("XDG_STATE_HOME", "state")
    said = "teleop: XDG_STATE_HOME=state: is relative; set it to an absolute path"
    assert refused("stop") == said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("home", [None, "here"])
def test_a_user_without_a_home_is_told_what_to_set(environment, home, refused):
    environment.delenv("HOME")
    if home is not None:
        environment.setenv("HOME", home)
    environment.setattr(pwd, "getpwuid", {}.__getitem__)
    said = "has no home folder (HOME); set XDG_STATE_HOME to a folder of this user"
    assert said in refused("stop")
