"""What `--view`, `--out` and FILE of `teleop view` mean, and where the runtime's own lines go."""

import os

import pytest

from teleop.errors import UsageError
from teleop.view.command import choose_destination, divert_stderr


def test_a_file_name_that_ends_in_rrd_is_a_view(tmp_path):
    file = tmp_path / "a.rrd"
    assert choose_destination(file, None) == ("rrd", file)
    assert choose_destination("web", file) == ("web", file)
    with pytest.raises(UsageError, match="name the file once"):
        choose_destination(file, tmp_path / "b.rrd")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["view", "--view", "a.txt"], "ends in .rrd"),
        (["view", "here.rrd", "--view", "rrd"], "is a Rerun file already"),
        (["view", "absent.rrd", "--view", "web"], "absent.rrd: cannot be read"),
        (["view", "text.rrd", "--view", "web"], "is no Rerun file"),
        (["view", "noise.rrd", "--view", "web"], "noise.rrd: is damaged: "),
        (["view", "pipe.rrd", "--view", "web"], "pipe.rrd: is not a file"),
        (["view", "rig.yaml"], "is a config; teleop view --config rig.yaml"),
    ],
)
def test_a_view_that_cannot_be_is_refused_in_one_line(words, said, tmp_path, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.rrd").write_text("text")
    (tmp_path / "noise.rrd").write_bytes(b"RRF2" + bytes(range(256)) * 20)
    os.mkfifo(tmp_path / "pipe.rrd")
    assert said in refused(*words)


def test_lines_of_native_code_go_to_the_log_and_ours_to_the_terminal(tmp_path, capfd):
    path = tmp_path / "state" / "view.log"
    with divert_stderr(path) as used:
        assert used == path
        os.write(2, b"from native code\n")
    os.write(2, b"ours\n")
    assert path.read_text() == "from native code\n"
    assert capfd.readouterr().err == "ours\n"
