"""Every benchmark can be imported: `make test` runs none of them."""

import importlib
from pathlib import Path

import pytest

from studies.hidden.scales import Answer, unlike
from studies.rigs.jobs import require_stopped

BENCHMARKS = Path(__file__).parents[2] / "studies"
MODULES = [
    ".".join(path.relative_to(BENCHMARKS).with_suffix("").parts)
    for path in sorted(BENCHMARKS.rglob("*.py"))
    if path.stem not in ("__init__", "__main__")
]


@pytest.mark.parametrize("name", MODULES)
def test_a_benchmark_can_be_imported(name, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))  # as for a script of that folder
    importlib.import_module(f"studies.{name}")


def test_a_number_that_only_one_size_of_a_bench_has_is_a_difference():
    of_both, of_one = {"K": (0.8, 0.01)}, {"K": (0.8, 0.01), "L/EA": (1e-4, 1e-6)}
    for one, other in ((of_one, of_both), (of_both, of_one)):
        (said,) = unlike(Answer("clean", (), one), Answer("clean", (), other))
        assert said.startswith("L/EA ")
    assert unlike(Answer("clean", (), of_one), Answer("clean", (), of_one)) == []
    (said,) = unlike(Answer("clean", (), {"K": (0.9, 0.01)}), Answer("clean", (), of_both))
    assert said.startswith("K 0.9")


@pytest.mark.parametrize("times_s", [(-2.0, -0.3, 0.01), (-3.0, -0.004), (0.049,)])
def test_motors_that_stop_soon_after_a_kill_pass(times_s):
    assert require_stopped(times_s).startswith("last motion ")


@pytest.mark.parametrize(
    ("times_s", "said"), [((-2.0, -0.3), "no motor was in motion"), ((0.01, 0.06), "60 ms after")]
)
def test_kills_at_rest_show_nothing_and_late_stops_fail(times_s, said):
    with pytest.raises(AssertionError, match=said):
        require_stopped(times_s)
