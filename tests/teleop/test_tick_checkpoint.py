import numpy as np
import pytest

from teleop.runtime.clock import STALL_NS
from teleop.session import tick_checkpoint
from teleop.session.tick_checkpoint import Checkpoint

DTYPE = np.dtype([("position", "f8"), ("flag", "?"), ("count", "i8", (3,))], align=True)


@pytest.fixture
def state():
    records = np.zeros(1, DTYPE), np.zeros(2, DTYPE)
    records[0]["position"], records[1]["count"] = 1.5, 7
    return records


def change(state):
    for records in state:
        records["position"] += 1.0
        records["flag"] = True
        records["count"][:, 1] = -1


def to_bytes(state):
    return [records.tobytes() for records in state]


def test_all_of_the_state_is_restored_as_often_as_wanted(state):
    checkpoint, before = Checkpoint(*state), to_bytes(state)
    for _ in range(2):
        change(state)
        assert to_bytes(state) != before
        checkpoint.restore()
        assert to_bytes(state) == before


class Process:
    """Steps that take as long as they are told."""

    def __init__(self, state, monkeypatch, *durations_ns):
        self.state, self.durations_ns, self.stamp_ns = state, list(durations_ns), 1000
        self.steps = []
        monkeypatch.setattr(tick_checkpoint, "now_ns", lambda: self.stamp_ns)

    def step(self, now_ns, dt):
        self.steps.append((now_ns, dt))
        change(self.state)
        self.stamp_ns += self.durations_ns.pop(0)
        return len(self.steps)


def test_a_step_without_a_stall_stands(state, monkeypatch):
    process = Process(state, monkeypatch, STALL_NS)
    assert Checkpoint(*state).run_step(process.step, 1000, 1e-3) == 1
    assert process.steps == [(1000, 1e-3)]
    assert state[0]["position"] == 2.5


@pytest.mark.parametrize("second_ns", [0, 10 * STALL_NS])
def test_a_stalled_step_is_undone_and_repeated_once_with_the_time_that_has_passed(
    state, monkeypatch, second_ns
):
    process = Process(state, monkeypatch, 2 * STALL_NS, second_ns)
    assert Checkpoint(*state).run_step(process.step, 1000, 1e-3) == 2
    assert process.steps == [(1000, 1e-3), (1000 + 2 * STALL_NS, pytest.approx(0.011))]
    assert state[0]["position"] == 2.5


def test_a_stall_before_the_step_counts_as_one_in_it(state, monkeypatch):
    """What the step is given was true at `begin_ns`."""
    process = Process(state, monkeypatch, 0, 0)
    process.stamp_ns += 2 * STALL_NS
    Checkpoint(*state).run_step(process.step, 1000, 0.0)
    assert [stamp for stamp, _ in process.steps] == [1000, 1000 + 2 * STALL_NS]
