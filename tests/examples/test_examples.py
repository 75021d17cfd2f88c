"""Every example runs from its file alone, and what it says is right."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
LONGEST = {"walk_through.py": 120, "stiffness_discrimination.py": 60}  # [lines]


def run(folder, name, *words):
    """Run an example in a folder that has nothing else; return what it prints."""
    ended = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        timeout=500,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_every_example_is_short_and_tested():
    files = sorted(path.name for path in EXAMPLES.glob("*.py"))
    tested = re.findall(r'run\(tmp_path, "(\w+\.py)"', Path(__file__).read_text())
    sessions = Path(__file__).with_name("test_session_examples.py").read_text()
    tested += re.findall(r'run\(tmp_path, "(\w+\.py)"', sessions)
    assert files == sorted(set(tested))
    for name in files:
        lines = (EXAMPLES / name).read_text().splitlines()
        assert len(lines) <= LONGEST.get(name, 40), name


def test_the_law_gives_the_tip_less_by_friction(tmp_path):
    said = run(tmp_path, "law_loop.py", tmp_path / "loop.png")
    assert float(re.search(r"are ([\d.]+) N at the tip", said)[1]) == pytest.approx(8.99, abs=0.01)
    assert float(re.search(r"come back to ([\d.]+) N", said)[1]) == pytest.approx(4.04, abs=0.05)
    assert (tmp_path / "loop.png").stat().st_size > 10_000


def test_hand_and_joints_have_the_same_power_also_at_a_limit(tmp_path):
    said = run(tmp_path, "arm_kinematics.py")
    hand, joints = map(float, re.findall(r"(?:hand|joints) ([\d.]+) mJ", said))
    assert hand == joints > 30.0
    assert " 50.0 mm: bend 0.60, wrist 0.50 rad" in said


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_a_fit_on_one_half_holds_on_the_other(tmp_path):
    said = run(tmp_path, "estimate_record.py")
    assert float(re.search(r"RMSE ([\d.]+) N", said)[1]) < 0.2
    assert int(re.search(r"(\d+)% of it", said)[1]) > 90


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_the_effect_that_was_put_in_is_found(tmp_path):
    said = run(tmp_path, "diagnose_record.py")
    assert "the load cell at the tip has a wrong gain" in said.partition("\n\n")[0]
    gain = re.search(r"distal_tension_gain.gain +\| +([\d.]+)", said)[1]
    assert float(gain) == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_a_diagnosis_is_a_page_of_its_own(tmp_path):
    said = run(tmp_path, "notebook_report.py", tmp_path / "report.html")
    before, after = re.search(r"validation: .* by ([\d.]+) N before, ([\d.]+) N", said).groups()
    assert float(after) < 0.5 * float(before)
    page = (tmp_path / "report.html").read_text()
    assert page.startswith("<div>")
    assert page.count("<svg") >= 4


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_a_pair_s_friction_grows_as_it_was_put_in(tmp_path):
    said = run(tmp_path, "pair_study.py")
    assert float(re.search(r"grows by ([\d.]+)", said)[1]) == pytest.approx(0.2, rel=0.1)
    assert float(re.search(r"apart: ([\d.]+)%", said)[1]) < 3.0


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_the_analysis_of_the_readme_runs_as_it_is(tmp_path):
    snippet = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    words = "simulate --out bench.csv --duration 12 --rate 100 --profile nested"
    subprocess.run([sys.executable, "-m", "teleop", *words.split()], cwd=tmp_path, check=True)
    ended = subprocess.run(
        [sys.executable, "-c", snippet], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "| K " in ended.stdout


@pytest.mark.slow  # .ci/run runs it from the wheel
def test_the_walk_through_ends_with_the_cause_of_its_data(tmp_path):
    said = run(tmp_path, "walk_through.py")
    verdict = next(line for line in said.splitlines() if line.startswith("verdict:"))
    assert verdict == "verdict: named, causes: friction_step"


def test_an_experiment_finds_the_threshold_that_is_hidden_in_the_observer(tmp_path):
    said = run(tmp_path, "stiffness_discrimination.py", tmp_path / "study")
    low, high = re.search(r"interval ([\d.]+) to ([\d.]+)", said).groups()
    assert float(low) < 0.15 < float(high) < float(low) + 0.15
