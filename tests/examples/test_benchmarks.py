"""Every benchmark can be imported: `make test` runs none of them."""

import importlib
from pathlib import Path

import pytest

from studies.rigs.jobs import require_stopped

BENCHMARKS = Path(__file__).parents[2] / "studies"
MODULES = [
    ".".join(path.relative_to(BENCHMARKS).with_suffix("").parts)
    for path in sorted(BENCHMARKS.rglob("*.py"))
    if path.stem not in ("__init__", "__main__")
]


@pytest.mark.parametrize("name", MODULES)
def test_a_benchmark_can_be_imported(name):
    importlib.import_module(f"studies.{name}")


@pytest.mark.parametrize("times_s", [(-2.0, -0.3, 0.01), (-3.0, -0.004), (0.049,)])
def test_motors_that_stop_soon_after_a_kill_pass(times_s):
    assert require_stopped(times_s).startswith("last motion ")


@pytest.mark.parametrize(
    ("times_s", "said"), [((-2.0, -0.3), "no motor was in motion"), ((0.01, 0.06), "60 ms after")]
)
def test_kills_at_rest_show_nothing_and_late_stops_fail(times_s, said):
    with pytest.raises(AssertionError, match=said):
        require_stopped(times_s)
