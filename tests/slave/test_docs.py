"""What the pages of docs/ show can be used as it stands."""

import re
from pathlib import Path

import pytest

from teleop.cli import commands

RIGS = Path(__file__).parents[2] / "docs" / "how-to" / "rigs.md"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    """Return the config shown in docs/how-to/rigs.md, as a file."""
    blocks = re.findall(r"^```yaml\n(.*?)^```", RIGS.read_text(), re.M | re.S)
    (text,) = (block for block in blocks if "type: simulated" in block)
    path = tmp_path_factory.mktemp("docs") / "rig.yaml"
    path.write_text(text)
    return path


def test_the_rig_of_the_page_is_simulated_and_its_model_is_right(config, tmp_path, capsys):
    data = str(tmp_path / "data.csv")
    assert commands.main(["simulate", str(config), "--out", data, "--duration", "6"]) == 0
    capsys.readouterr()
    assert commands.main(["estimate", data, "--config", str(config)]) == 0
    assert re.search(r"RMSE 0\.0\d+ N", capsys.readouterr().out)


@pytest.mark.slow
def test_the_rig_of_the_page_is_calibrated_as_the_page_says(config, tmp_path):
    words = ["calibrate", "--config", str(config), "--quick"]
    assert commands.main([*words, "--out", str(tmp_path / "calibration.yaml")]) == 0
