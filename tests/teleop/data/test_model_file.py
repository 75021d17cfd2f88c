"""model.yaml: what is written is read again, and what cannot be right is refused in one line."""

import pytest
import yaml

from estimator.diagnosis.dataset import Model
from estimator.diagnosis.outcome import LiveError
from estimator.effects import CATALOGUE
from teleop.data import model_file
from teleop.errors import UsageError


def middling(effect):
    """Return an effect with values that are neither round nor neutral."""
    return effect, tuple(p.low + (p.high - p.low) / 3.0 for p in effect.parameters)


def test_every_effect_comes_back_to_the_bit(tmp_path):
    path = tmp_path / "model.yaml"
    model = Model((0.1 + 0.2, 1.0 / 7000.0, 3e-4), (), tuple(map(middling, CATALOGUE)))
    saved = model_file.SavedModel(model, 61.7, ("creep",), live_error=LiveError(0.28, 0.16))
    model_file.save(path, saved, "two\nlines")
    assert model_file.load(path) == saved
    assert path.read_text().startswith("# two\n# lines\n")


def test_what_single_records_had_is_left_out(tmp_path):
    path = tmp_path / "model.yaml"
    of_two = Model((0.5,), ((1e-3,), (2e-3,)), ())
    model_file.save(path, model_file.SavedModel(of_two, 1.0, ()), "")
    assert model_file.load(path).model == Model((0.5,), (), ())


@pytest.fixture
def tree():
    parameters = {"change": 0.25, "onset": 20.0}
    return {
        "base": {"K": 0.8, "compliance": 1e-4, "tip_compliance": 0.0},
        "duration": 60.0,
        "effects": [{"name": "friction_step", "where": "", "parameters": parameters}],
    }


def refusal(tmp_path, tree):
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(tree))
    with pytest.raises(UsageError) as caught:
        model_file.load(path)
    place, _, said = str(caught.value).partition(": ")
    assert place == str(path)
    assert "\n" not in said
    return said


def test_numbers_that_cannot_be_right_are_refused(tmp_path, tree):
    tree["base"]["K"] = 9.0
    assert refusal(tmp_path, tree) == "base.K: 9, must be 0.01 to 5"
    tree["base"]["K"] = "much"
    assert refusal(tmp_path, tree) == "base.K: 'much' is not a finite number"
    tree["base"]["K"], tree["duration"] = 0.5, -60.0
    assert refusal(tmp_path, tree) == "duration: -60 s, must be 0 to 1e+07 s"
    del tree["duration"]
    assert refusal(tmp_path, tree) == "duration: is missing"
    tree["duration"] = 60.0
    del tree["base"]["K"]
    assert refusal(tmp_path, tree) == "base.K: is missing"
    del tree["base"]
    assert "not a model file" in refusal(tmp_path, tree)


def test_a_model_that_makes_the_live_force_worse_is_refused(tmp_path, tree):
    tree["live_error"] = [0.28, 5.63]
    assert "is off by 5.63 N with this model, by 0.28 N without" in refusal(tmp_path, tree)
    tree["live_error"] = 0.28
    assert refusal(tmp_path, tree) == "live_error: must be a list of two errors [N]"


def test_numbers_of_benches_of_other_sizes_are_read_and_none_without_a_meaning(tmp_path, tree):
    path = tmp_path / "model.yaml"
    for compliance in (1e-9, 1.0):  # of 500 N over 0.3 mm, of 0.5 N over 80 mm
        tree["base"]["compliance"] = compliance
        path.write_text(yaml.safe_dump(tree))
        assert model_file.load(path).model.shared[1] == compliance
    for compliance in (0.0, -1e-12, 1e4):
        tree["base"]["compliance"] = compliance
        assert "base.compliance: " in refusal(tmp_path, tree)
    tree["base"] |= {"compliance": 1e-4, "tip_compliance": -1e-9}
    assert "base.tip_compliance: -1e-09 m/N, must be 0 to" in refusal(tmp_path, tree)


def test_unknown_words_are_refused_with_what_may_be_meant(tmp_path, tree):
    (row,) = tree["effects"]
    row["parameters"]["chnge"] = row["parameters"].pop("change")
    assert "parameters.chnge: unknown key; did you mean 'change'?" in refusal(tmp_path, tree)
    row["name"] = "friction_stp"
    assert "no effect 'friction_stp'; did you mean 'friction_step'" in refusal(tmp_path, tree)
    row["name"], row["where"] = "creep", "by night"
    assert "'by night' is no variant of creep: ''" in refusal(tmp_path, tree)
    tree["effects"] = {}
    tree["sheath"] = 1
    assert refusal(tmp_path, tree) == "sheath: unknown key"
    del tree["sheath"]
    tree["effects"] = "none"
    assert "effects: must be a list" in refusal(tmp_path, tree)


def test_a_function_without_a_range_and_a_second_one_are_refused(tmp_path, tree):
    names = [f"c{k}" for k in range(1, 13)]
    numbers = {"from": 0.01, "to": 0.01, **dict.fromkeys(names, 0.1)}
    function = {"name": "friction_by_position", "where": "", "parameters": numbers}
    tree["effects"] = [function]
    place = "effects.0.parameters: from 0.01, must be below to"
    assert refusal(tmp_path, tree) == place
    numbers["to"] = 0.02
    tree["effects"] = [function, {**function, "name": "elongation_by_position"}]
    tree["effects"][1]["parameters"] = numbers | dict.fromkeys(names, 1e-3)
    assert refusal(tmp_path, tree).endswith("one function at most is run")
