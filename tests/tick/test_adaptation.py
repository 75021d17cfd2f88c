"""A session in which a sheath moves: the slave follows K, says so, and renders the right force."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimator.adaptation import run_adapting
from estimator.online import online
from estimator.online.estimator_state import BOUND_SIGMAS
from slave.adaptation import compute_friction
from slave.calibration.monitor import Advice
from teleop.messages.messages import Sheath
from teleop.messages.topics import SHEATH
from teleop.session.state_machine import State
from tests.tick.session import HAND_ENGAGED, Session

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"
RATE = 250  # [Hz]
CHANGE, CHANGE_S, END_S = 0.3, 9.0, 24.0
BEFORE, AFTER = 0.78, 0.78 * (1.0 + CHANGE)
SETTINGS = (
    *HAND_ENGAGED,
    f"rate_hz={RATE}",
    "slave.rig.period=0.004",
    "slave.adaptation.enabled=true",
    f"slave.rig.effects=[{{type: friction_step, start: {CHANGE_S}, change: {CHANGE}}}]",
)


@pytest.fixture(scope="module")
def moved() -> Iterator[Any]:
    """A session of which the sheath has moved, with what the housing and the tip measured."""
    with ExitStack() as stack:
        session = Session(stack, SETTINGS, file=DEMO)
        process, measured, sheaths, advice, said = session.slave, [], [], set(), {}
        rendered = []
        published = process._link.publish

        def listen(topic: Any, message: Any) -> None:
            if topic is SHEATH:
                sheaths.append(message)
            published(topic, message)

        stack.enter_context(pytest.MonkeyPatch.context()).setattr(process._link, "publish", listen)
        for k in range(round(END_S * RATE)):
            session.tick()
            row = process._rows[0]
            tendon = row["tendons"][0]
            measured.append((
                row["time_s"], tendon["tension"], tendon["displacement"], row["bench_tension"][0],
                *(tendon["estimate"][name] for name in ("distal_tension", "low", "high")),
            ))  # fmt: skip
            force = process._slave.scratch["force"][0, 0]
            rendered.append((force, process.memory.joints[0].force, row["bench_tension"][0]))
            advice.add(int(process.memory.advice))
            for text in process._telemetry.shape_changes[len(said) :]:
                said[text] = k / RATE
        yield SimpleNamespace(
            session=session,
            data=np.unique(measured, axis=0),
            rendered=np.array(rendered),
            sheaths=sheaths,
            advice=advice,
            said=said,
        )


def test_friction_follows_the_sheath_and_the_force_is_right_again(moved: Any) -> None:
    slave = moved.session.slave._slave
    now = compute_friction(slave.prepared, slave.adapter, 0)
    assert abs(now.K - AFTER) < 0.05 * AFTER
    assert now.low < AFTER < now.high
    t, T, q, tip, estimate, low, high = moved.data.T.copy()
    late = t > END_S - 5.0
    assert np.mean((low <= tip) & (tip <= high)) > 0.999
    full = tip[late].max()
    model = moved.session.slave._model.models[0]
    fixed = online.run(online.prepare(model), t, T, q)
    offline = run_adapting(model, t, T, q)
    np.testing.assert_allclose(now, [offline.K[-1], offline.K_low[-1], offline.K_high[-1]], 1e-6)
    np.testing.assert_allclose(estimate, offline.estimates.distal_tension, 1e-6)
    errors = [np.abs(t - tip)[late] / full for t in (estimate, fixed.distal_tension)]
    assert np.percentile(errors[0], 90) < 0.05 < 0.10 < np.percentile(errors[1], 90)
    assert np.mean(((fixed.low <= tip) & (tip <= fixed.high))[late]) < 0.8


def test_the_hand_never_gets_more_than_the_true_force_also_while_it_moves(moved: Any) -> None:
    rendered, estimate, tip = moved.rendered.T
    noise = BOUND_SIGMAS * 0.01 * np.exp(AFTER)
    assert (estimate > tip + 0.5).any()
    assert (rendered < tip + noise).all()
    assert rendered.sum() > 0.5 * tip.sum()


def test_a_change_of_shape_is_said_as_it_begins_and_as_it_has_settled(moved: Any) -> None:
    (begun, begun_s), (settled, settled_s) = moved.said.items()
    assert begun == "the shape changes: K of joint 1, tendon a leaves 0.78"
    assert CHANGE_S < begun_s < CHANGE_S + 5.0 < settled_s
    head, tail = settled.split(" to ")
    assert head.endswith("K of joint 1, tendon a from 0.78")
    said_K, error = map(float, tail.split(" ± "))
    assert abs(said_K - AFTER) < min(error, 0.05 * AFTER)
    *before, last = moved.session.slave.summarise().rig.friction
    assert before == [begun, settled]
    assert last.startswith("K of joint 1, tendon a: ")
    assert last.endswith("; calibrated 0.78")


def test_listeners_have_friction_with_its_interval_once_a_second(moved: Any) -> None:
    assert END_S - 1.0 <= len(moved.sheaths) <= END_S + 1.0
    first, last = moved.sheaths[5], moved.sheaths[-1]
    assert isinstance(last, Sheath)
    assert first.effective_friction == pytest.approx(BEFORE)
    assert first.friction_low < BEFORE < first.friction_high
    assert last.friction_low < AFTER < last.friction_high


def test_no_calibration_is_advised_where_the_adaptation_decides(moved: Any) -> None:
    """The same session with the K of the calibration ends in a fault: `CALIBRATION_DUE`."""
    assert moved.advice == {Advice.NONE}
    assert moved.session.slave.summarise().final_state is State.ENGAGED
