"""The force in the hand while a wall is pressed and the tube is bent, of whole sessions.

python -m studies.moving_sheath                     a tendon against a spring, configs/demo.yaml
python -m studies.moving_sheath --pair              a pair of tendons, configs/paper-joint.yaml
python -m studies.moving_sheath --image FILE        draws it, too
python -m studies.moving_sheath --recordings FOLDER keeps the recordings; uses those that are there

Two sessions of `teleop run`, with the K of the calibration and with adaptation: a scripted hand
presses a wall again and again. While it holds a press, all friction grows by `--change` within 2 s.
Load cells have 0.02 N of noise, encoders errors of 1 um. The monitor, which would end the session
without adaptation, is off. What the hand gets, what was estimated and what the tip truly pulls with
are read from the recordings. Takes 3 minutes.
"""

import contextlib
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.figure_style import BLUE, GREEN, VERMILION, use_style
from studies.testbed.command import parse_options
from studies.testbed.processes import DEMO_CONFIG, START_S, Processes, has_ended_well
from teleop.messages.topics import HAND, SHEATH, STATE, TENDONS
from teleop.recording.reader import read_columns

MODES = {"fixed K": VERMILION, "adapted": BLUE}
TRUE = "#E69F00"  # Okabe and Ito
PAIR_CONFIG = DEMO_CONFIG.with_name("paper-joint.yaml")
SCALE = 0.2  # force in the hand over that at the tip
REACH_S, REST_S = 0.8, 0.4
UNIT_S = REACH_S + REST_S
PRESS, FREE = 0.026, 0.004  # [m] where the hand goes
WALL = "{type: wall, position: 0.004, stiffness: 1500, damping: 5}"
REST, BEFORE, HELD, AFTER = 3, 4, 6, 10  # units at rest, presses, units of one press, presses
PRESS_UNITS = 3  # of the others and the release after each
CHANGE_S, GROW_S = 20.5, 2.0  # [s] of the rig
END_S = UNIT_S * (REST + PRESS_UNITS * BEFORE + HELD + 1 + PRESS_UNITS * AFTER)
WINDOWS = (  # [s]
    ("before", 8.0, CHANGE_S),
    ("while it moves", CHANGE_S, CHANGE_S + 4.5),
    ("next two presses", CHANGE_S + 4.5, CHANGE_S + 12.0),
    ("after", END_S - 20.0, END_S - 1.0),
)
DRAWN_S = 8.0  # of a window
ALLOWED = 0.05  # error, of full scale


class Session(NamedTuple):
    """What a recording holds, at the samples of the rig; forces [N] are in the hand."""

    time: Array  # [s] of the rig
    true: Array
    estimate: Array
    low: Array  # ends of its interval
    high: Array
    hand: Array
    K_time: Array  # [s] of the rig
    K: NDArray[np.void]  # messages `sheath` of tendon a

    def find_full_scale(self) -> float:
        """Return the largest true force."""
        return float(self.true[self.time > WINDOWS[0][1]].max())


def list_settings(options: Namespace, adapts: bool) -> list[str]:
    """Return the overrides of a session."""
    press = [PRESS, PRESS, -FREE if options.pair else FREE]
    targets = [0.0] * REST + press * BEFORE + [PRESS] * HELD + press[-1:] + press * AFTER
    joint = "slave.rig.joints.0"
    sensors = [
        f"{joint}.tendons.{i}.{text}"
        for i in range(2 if options.pair else 1)
        for text in ("load_cell={noise: 0.02, resolution: 0.002}", "encoder={lines: 18000}")
    ]
    growth = options.change / GROW_S
    return [
        *sensors,
        f"{joint}.environment={WALL}",
        f"slave.rig.effects=[{{type: friction_drift, start: {CHANGE_S}, per_second: {growth}, "
        f"limit: {abs(options.change)}}}]",
        f"slave.adaptation.enabled={str(adapts).lower()}",
        "slave.monitor={advise: 10, demand: 10}",
        "slave.command_timeout=0.15",
        "master.state_timeout=0.15",
        "master.delay_max=0.2",
        f"master.device.reference={{type: reaches, targets: {targets}, reach: {REACH_S}, "
        f"rest: {REST_S}}}",
        f"master.device.engage=[[0.5, {2.0 * END_S}]]",
        f"master.device.engage_period={3.0 * END_S}",
        f"master.force.scale={SCALE}",
    ]


def run_session(folder: Path, options: Namespace, adapts: bool) -> None:
    """Record a session into a folder."""
    config = PAIR_CONFIG if options.pair else DEMO_CONFIG
    with Processes(folder, config, *list_settings(options, adapts)) as session:
        words = ("--view", "none", "--record", str(folder), "--duration", str(END_S))
        code = session.start("run", *words).wait(END_S + 2.0 * START_S)
        if not has_ended_well(code, session.outputs()):
            raise RuntimeError(session.outputs())


def read_session(folder: Path) -> Session:
    """Return what the recording in a folder holds."""
    (path,) = folder.glob("*.mcap")
    tendons, state, hand, sheath = (
        read_columns(path, topic.name) for topic in (TENDONS, STATE, HAND, SHEATH)
    )
    time, sent = tendons["time_s"], tendons["publish_time_ns"]
    tips = tendons["bench_distal_tension"][:, : tendons["tendons"][0]]
    estimates = [
        SCALE * np.interp(sent, state["publish_time_ns"], state[name][:, 0])
        for name in ("force", "force_low", "force_high")
    ]
    K = sheath[sheath["tendon"] == 0]
    return Session(
        time,
        SCALE * (tips[:, 0] - tips[:, 1:].sum(axis=1)),
        *estimates,
        np.interp(sent, hand["publish_time_ns"], -hand["force"][:, 0]),
        np.interp(K["publish_time_ns"], sent, time),
        K,
    )


def find_delay(session: Session, force: Array) -> float:
    """Return the time [s] from the change on until `force` is right, infinite if never.

    It is right where its error over a press and a release is within 5 % of full scale on average,
    and stays so.
    """
    error = np.abs(force - session.true) / session.find_full_scale()
    begin = np.arange(CHANGE_S, session.time[-1] - PRESS_UNITS * UNIT_S, UNIT_S)
    edges = np.searchsorted(session.time, [begin, begin + PRESS_UNITS * UNIT_S]).T
    wrong = [k for k, (i, j) in enumerate(edges) if error[i:j].mean() > ALLOWED]
    first = wrong[-1] + 1 if wrong else 0
    return float(begin[first] - CHANGE_S) if first < len(begin) else np.inf


def report(mode: str, session: Session) -> None:
    """Print the figures of a session."""
    full, true = session.find_full_scale(), session.true
    is_inside = (session.low <= true + 1e-6) & (true <= session.high + 1e-6)
    print(f"{mode}: largest true force {full:.2f} N in the hand; within 5 % of it from "
          f"{find_delay(session, session.estimate):.1f} s (estimate) and "
          f"{find_delay(session, session.hand):.1f} s (hand) after the change on")  # fmt: skip
    for name, begin, end in WINDOWS:
        chosen = (session.time >= begin) & (session.time < end)
        print(f"  {name}: inside the interval {is_inside[chosen].mean():.2%}")
        for label, force in (("estimate", session.estimate), ("in the hand", session.hand)):
            error = 100.0 * (force - true)[chosen] / full
            more = 100.0 * (force * np.sign(true) - np.abs(true))[chosen] / full
            print(f"    {label:12} RMS {np.sqrt(np.mean(error**2)):.1f} %, largest error "
                  f"{np.abs(error).max():.1f} %; above the true force by {more.max():.1f} % at "
                  f"most, by 5 % in {np.mean(more > 100.0 * ALLOWED):.1%} of time; mean over true "
                  f"{force[chosen].mean() / true[chosen].mean():.0%}")  # fmt: skip


def draw(sessions: list[Session], change: float) -> Figure:
    """Return the figure: forces in stretches of time, K over all of it."""
    names = [name for name, _, _ in WINDOWS]
    figure = Figure(figsize=(7.6, 6.2))
    parts = figure.subplot_mosaic(
        [*([f"{mode} {name}" for name in names] for mode in MODES), ["K"] * len(names)],
        height_ratios=[1.3, 1.3, 1.0],
    )
    top = 1.05 * max(max(s.true.max(), s.estimate.max(), s.hand.max()) for s in sessions)
    bottom = 1.05 * min(0.0, *(s.true.min() for s in sessions))
    K = parts["K"]
    for (mode, colour), session in zip(MODES.items(), sessions, strict=True):
        for name, begin, end in WINDOWS:
            chosen = (session.time >= max(begin, end - DRAWN_S)) & (session.time < end)
            t, part = session.time[chosen], parts[f"{mode} {name}"]
            part.fill_between(t, session.low[chosen], session.high[chosen], color=colour,
                              alpha=0.2, lw=0.0, label=f"interval, {mode}")  # fmt: skip
            part.plot(t, session.true[chosen], color=TRUE, lw=3.5, label="true")
            part.plot(t, session.estimate[chosen], color=colour, lw=1.3, label=f"estimate, {mode}")
            part.plot(t, session.hand[chosen], color=GREEN, lw=1.0, label="in the hand")
            part.set(ylim=(bottom, top), title=name if mode == next(iter(MODES)) else "")
            part.tick_params(labelleft=name == names[0])
        parts[f"{mode} {names[0]}"].set_ylabel("force at the hand [N]")
        ends = session.K["friction_low"], session.K["friction_high"]
        K.fill_between(session.K_time, *ends, color=colour, alpha=0.2, lw=0.0)
        K.plot(session.K_time, session.K["effective_friction"], color=colour)
    shape = np.array([1.0, 1.0, 1.0 + change, 1.0 + change])
    true_K = sessions[0].K["effective_friction"][0] * shape
    K.plot([0.0, CHANGE_S, CHANGE_S + GROW_S, END_S], true_K, color=TRUE, lw=3.5, zorder=1.0)
    K.set(ylabel="K", xlabel="time [s]", xlim=(0.0, END_S))
    labels = {
        label: line
        for mode in MODES
        for line, label in zip(
            *parts[f"{mode} {names[0]}"].get_legend_handles_labels(), strict=True
        )
    }
    figure.legend(labels.values(), labels.keys(), loc="outside upper center", ncols=3)
    return figure


def main() -> None:
    """Run the sessions, print their figures and draw them."""
    options = parse_options(
        __doc__,
        pair=(False, "a pair of tendons"),
        change=(0.5, "relative change of friction"),
        recordings=(Path, "folder of recordings"),
        image=(Path, "file of the picture"),
    )
    with contextlib.ExitStack() as stack:
        folder = options.recordings or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        sessions = []
        for mode in MODES:
            place = folder / mode.replace(" ", "-")
            if not list(place.glob("*.mcap")):
                place.mkdir(parents=True, exist_ok=True)
                run_session(place, options, mode == "adapted")
            sessions.append(read_session(place))
            report(mode, sessions[-1])
    if options.image:
        with use_style():
            draw(sessions, options.change).savefig(options.image)


if __name__ == "__main__":
    main()
