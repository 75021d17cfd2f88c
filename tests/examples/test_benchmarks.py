"""Every benchmark can be imported: `make test` runs none of them."""

import importlib
from pathlib import Path

import pytest

from benchmarks.hidden.scales import Answer, unlike

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
MODULES = [
    ".".join(path.relative_to(BENCHMARKS).with_suffix("").parts)
    for path in sorted(BENCHMARKS.rglob("*.py"))
    if path.stem not in ("__init__", "__main__")
]


@pytest.mark.parametrize("name", MODULES)
def test_a_benchmark_can_be_imported(name, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))  # as for a script of that folder
    importlib.import_module(f"benchmarks.{name}")


def test_a_number_that_only_one_size_of_a_bench_has_is_a_difference():
    of_both, of_one = {"K": (0.8, 0.01)}, {"K": (0.8, 0.01), "L/EA": (1e-4, 1e-6)}
    for one, other in ((of_one, of_both), (of_both, of_one)):
        (said,) = unlike(Answer("clean", (), one), Answer("clean", (), other))
        assert said.startswith("L/EA ")
    assert unlike(Answer("clean", (), of_one), Answer("clean", (), of_one)) == []
    (said,) = unlike(Answer("clean", (), {"K": (0.9, 0.01)}), Answer("clean", (), of_both))
    assert said.startswith("K 0.9")
