"""What a recording says of a side: how long it went on after the last fresh message, and moved.

Only the recording is looked at. A message is *heard* in the tick in which a side first echoes its
stamp, and *fresh* if it was sent no longer before than `FRESH_NS`. The silence at a tick is the
time since the newest fresh message was heard.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from studies.faults.injection import Fault
from studies.faults.session import HELD, PERIOD
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.recording.reader import RecordingError, read_columns
from teleop.session.state_machine import State

FRESH_NS = 30_000_000
SLACK_S = 0.2  # [s] between a process's start and its first message
HEAD = ("sender", "sequence", "stamp_ns")
FOLLOWS_NS = 200_000_000  # within which a slave engages that its master waits for
GAP_NS = 20_000_000  # between two ticks: the process stood still
ENGAGED = State.ENGAGED
YIELDING = ("CLUTCHED", "HOLDING")  # states in which motors may give way to a tension


class Ticks(NamedTuple):
    """The ticks of one side, in tick order; times by our clock."""

    sender: np.ndarray
    sequence: np.ndarray
    raw_ns: np.ndarray  # on the side's own clock
    start_ns: np.ndarray  # when its first tick was, by that clock
    stamp_ns: np.ndarray
    state: np.ndarray
    silence_ns: np.ndarray
    acts: np.ndarray  # whether it moved the motors, or pushed the hand
    tick_ns: int  # period of the loop


def read_rows(paths: list[Path], topic: str, names: list[str]) -> np.ndarray:
    """Return the rows of all recordings, in the order in which they were sent."""
    parts = []
    for path in paths:
        try:
            parts.append(read_columns(path, topic, ["log_time_ns", *HEAD, *names]))
        except RecordingError:  # killed before it had any
            continue
    rows = np.concatenate(parts)
    _, first = np.unique(rows[["sender", "sequence"]], return_index=True)
    rows = rows[first]
    starts = {s: rows["log_time_ns"][rows["sender"] == s].min() for s in set(rows["sender"])}
    order = np.lexsort((rows["sequence"], [starts[s] for s in rows["sender"]]))
    return rows[order]


def correct_stamps(
    rows: np.ndarray, own_messages: np.ndarray, faults: list[Fault], target: str
) -> np.ndarray:
    """Return the stamps as if the sender's clock had never been made to jump.

    `own_messages` are messages of the same side that echo its peer's stamps.
    """
    stamps = rows["stamp_ns"].copy()
    for fault in faults:
        jump = round(fault.jump_s * 1e9)
        if fault.target != target or not jump:
            continue
        half = abs(jump) // 2
        for sender in np.unique(rows["sender"]):
            mine = rows["sender"] == sender
            if stamps[mine].min() > fault.begin_ns or stamps[mine].max() < fault.begin_ns:
                continue
            if jump > 0:
                after = stamps > fault.begin_ns + half
            else:  # the loop ends its tick, and waits for its clock
                newest = np.maximum.accumulate(np.where(mine, stamps, 0))
                after = stamps > find_set_back(own_messages, fault, sender)
                after |= (stamps < newest - half) & (newest > fault.begin_ns - half)
            stamps[mine & after] -= jump
    return stamps


def find_set_back(own_messages: np.ndarray, fault: Fault, sender: int) -> int:
    """Return what a clock that was set back told then: from there on the peer is far ahead."""
    near = abs(own_messages["stamp_ns"] - fault.begin_ns) < 200_000_000
    near &= (own_messages["sender"] == sender) & (own_messages["echo_stamp_ns"] != 0)
    stamps, ahead = own_messages["stamp_ns"][near], np.diff(own_messages["echo_stamp_ns"][near])
    if not ahead.size or ahead.max() < abs(fault.jump_s) * 0.5e9:
        return fault.begin_ns
    first = int(ahead.argmax())
    return int(stamps[first : first + 2].mean())


def compute_silences(
    rows: np.ndarray, stamps: np.ndarray, peer_messages: np.ndarray, sent: np.ndarray
) -> np.ndarray:
    """Return the silence at each tick [ns].

    `peer_messages` holds rows of the peer's messages and `sent` their true times; a message that
    was not recorded is taken as fresh.
    """
    echo = rows["echo_stamp_ns"]
    new = np.concatenate([[False], (echo[1:] != echo[:-1]) & (echo[1:] != 0)])
    order = np.argsort(peer_messages["stamp_ns"], kind="stable")
    known = peer_messages["stamp_ns"][order]
    place = np.minimum(np.searchsorted(known, echo), len(known) - 1)
    late = np.where(known[place] == echo, stamps - sent[order][place], 0)
    fresh = np.where(new & (late <= FRESH_NS), stamps, np.iinfo(np.int64).min // 2)
    return stamps - np.maximum.accumulate(fresh)


def find_ticks(
    rows: np.ndarray, stamps: np.ndarray, ticks: np.ndarray, ticks_ns: np.ndarray
) -> np.ndarray:
    """Return which of `ticks` each row was sent in: the same sender's last one before it."""
    out = np.zeros(len(rows), int)
    for sender in np.unique(rows["sender"]):
        here = np.flatnonzero(ticks["sender"] == sender)
        mine = np.flatnonzero(rows["sender"] == sender)
        before = np.searchsorted(ticks_ns[here], stamps[mine], "right") - 1
        out[mine] = here[np.maximum(before, 0)]
    return out


class CampaignResult(NamedTuple):
    """What the recordings of a campaign say."""

    reactions: list[tuple[Fault, str, float]]  # fault, side, [s] it acted on after its peer's last
    worst: dict[str, float]  # [s] the longest silence in which a side acted, of the whole recording
    finished_late: dict[str, int]  # ticks that were begun before a stop and ended after it
    engaged_unasked: int  # engagements of the master that no press of the switch began
    followed_nobody: int  # engagements of the slave without the master's
    pulled_in: float  # [m] by motors of a slave that was not engaged
    let_out: float  # [m] by motors that had not even to give way
    engagements: int
    broken_off: list[str]  # faults that need not end an engagement, and did
    tick: float  # [s] of the slave


def judge_recordings(paths: list[Path], faults: list[Fault]) -> CampaignResult:
    """Look at all recordings of a session and at what was done to it."""
    command = read_rows(paths, COMMAND.name, ["state", "echo_stamp_ns"])
    state = read_rows(paths, STATE.name, ["state", "echo_stamp_ns"])
    hand = read_rows(paths, HAND.name, ["force"])
    command_ns = correct_stamps(command, command, faults, "master")
    state_ns = correct_stamps(state, state, faults, "slave")
    pushed = np.zeros(len(command), bool)
    pushed[
        find_ticks(hand, correct_stamps(hand, command, faults, "master"), command, command_ns)
    ] = hand["force"].any(axis=1)
    master = build_ticks(command, command_ns, state, state_ns, pushed)
    slave = build_ticks(state, state_ns, command, command_ns, state["state"] == ENGAGED)
    sides = {"master": master, "slave": slave}
    late = {name: find_late_ticks(side) for name, side in sides.items()}
    engaged = {name: find_onsets(side) for name, side in sides.items()}
    pulled_in, let_out = measure_motions(paths, faults, state, state_ns)
    starts = np.sort(master.stamp_ns[engaged["master"]])
    follows = slave.stamp_ns[engaged["slave"]]
    follows = follows[find_recorded(master, follows)]
    since = follows - starts[np.maximum(np.searchsorted(starts, follows) - 1, 0)]
    return CampaignResult(
        [
            (fault, name, measure_reaction(side, fault))
            for fault in faults
            for name, side in sides.items()
            if fault.concerns(name) and was_acting(side, fault)
        ],
        {
            name: (side.silence_ns[side.acts & ~late[name]].max() + side.tick_ns) * 1e-9
            for name, side in sides.items()
        },
        {name: int(late[name].sum()) for name in sides},
        count_unasked(master, engaged["master"]),
        int(np.sum((since < 0) | (since > FOLLOWS_NS))),
        pulled_in,
        let_out,
        len(starts),
        find_broken_off(master, faults),
        slave.tick_ns * 1e-9,
    )


def build_ticks(
    rows: np.ndarray,
    stamps: np.ndarray,
    peer_messages: np.ndarray,
    sent: np.ndarray,
    acts: np.ndarray,
) -> Ticks:
    """Return a side as its messages tell of it; arguments as of `compute_silences`."""
    silence = compute_silences(rows, stamps, peer_messages, sent)
    # the first may be missing; skipped ticks make the start seem later, so the least counts
    sequence = rows["sequence"].astype("i8")
    tick_ns = round(float(np.median(np.diff(rows["stamp_ns"]))))
    start = rows["stamp_ns"] - sequence * tick_ns
    return Ticks(
        rows["sender"], sequence, rows["stamp_ns"], start, stamps, rows["state"], silence, acts,
        tick_ns,
    )  # fmt: skip


def find_late_ticks(side: Ticks) -> np.ndarray:
    """Return the ticks in the middle of which the process stood still: acts decided on before.

    Such a tick ends long after the one before it, acts, and is the only one to do so.
    """
    gap = np.diff(side.stamp_ns, prepend=side.stamp_ns[0]) > GAP_NS
    next_acts = np.append(side.acts[1:], False)
    return gap & side.acts & ~next_acts & (side.silence_ns > GAP_NS)


def was_acting(side: Ticks, fault: Fault) -> bool:
    """Whether the side moved, or pushed, right before the fault."""
    before = (side.stamp_ns > fault.begin_ns - 20_000_000) & (side.stamp_ns <= fault.begin_ns)
    return bool(side.acts[before].any())


def measure_reaction(side: Ticks, fault: Fault) -> float:
    """Return how long [s] a side went on acting after the last fresh message it had heard."""
    span = 0 if np.isnan(fault.seconds) else fault.end_ns - fault.begin_ns
    within = (side.stamp_ns > fault.begin_ns - 5_000_000) & (
        side.stamp_ns < fault.begin_ns + max(span, 200_000_000)
    )
    silence = side.silence_ns[within & side.acts & ~find_late_ticks(side)]
    return float((silence.max(initial=0) + side.tick_ns) * 1e-9)


def find_onsets(side: Ticks) -> np.ndarray:
    """Return the ticks in which a side engaged."""
    engaged = side.state == ENGAGED
    same = (side.sender[1:] == side.sender[:-1]) & (np.diff(side.sequence) == 1)
    return 1 + np.flatnonzero(engaged[1:] & ~engaged[:-1] & same)


def find_broken_off(master: Ticks, faults: list[Fault]) -> list[str]:
    """Return the faults of bystanders in which an engagement ended though the switch was held."""
    engaged = master.state == ENGAGED
    same = (master.sender[1:] == master.sender[:-1]) & (np.diff(master.sequence) == 1)
    ends = 1 + np.flatnonzero(engaged[:-1] & ~engaged[1:] & same)
    starts = {s: master.start_ns[master.sender == s].min() for s in set(master.sender[ends])}
    began = np.array([starts[s] for s in master.sender[ends]], dtype="i8")
    pressed_s = ((master.raw_ns[ends] - began) * 1e-9 - HELD[0]) % PERIOD
    early = master.stamp_ns[ends[pressed_s < HELD[1] - HELD[0] - SLACK_S]]
    return [
        fault.name
        for fault in faults
        if not fault.disturbs
        and ((early >= fault.begin_ns) & (early <= fault.end_ns + FOLLOWS_NS)).any()
    ]


def find_recorded(side: Ticks, times_ns: np.ndarray) -> np.ndarray:
    """Return before which of `times_ns` all that `side` told for `FOLLOWS_NS` was recorded."""
    order = np.argsort(side.stamp_ns, kind="stable")
    stamps = side.stamp_ns[order]
    first, last = (np.searchsorted(stamps, t) for t in (times_ns - FOLLOWS_NS, times_ns))
    gaps = np.concatenate([[0], np.cumsum(np.diff(side.sequence[order]) != 1)])
    known = (last > first) & (gaps[np.maximum(last - 1, 0)] == gaps[first % len(gaps)])
    return known & (times_ns - stamps[np.maximum(last - 1, 0)] < GAP_NS)


def count_unasked(master: Ticks, engaged: np.ndarray) -> int:
    """Return how many engagements had no press of the switch of their own."""
    count = 0
    for sender in np.unique(master.sender):
        start = master.start_ns[master.sender == sender].min()
        times = master.raw_ns[engaged[master.sender[engaged] == sender]]
        since = (times - start) * 1e-9 - HELD[0] + SLACK_S
        press, within = np.divmod(since, PERIOD)
        count += int(np.sum(np.diff(press) < 1) + np.sum(within > HELD[1] - HELD[0] + SLACK_S))
    return count


def measure_motions(
    paths: list[Path], faults: list[Fault], state: np.ndarray, state_ns: np.ndarray
) -> tuple[float, float]:
    """Return how far [m] motors pulled in while not engaged, and let out unasked."""
    rows = read_rows(paths, TENDONS.name, ["tendons", "commanded_displacement"])
    count = int(rows["tendons"].max())
    asked = rows["commanded_displacement"][:, :count]
    followed = np.append(state["sequence"][1:] - state["sequence"][:-1] == 1, True)
    tick = find_ticks(rows, correct_stamps(rows, state, faults, "slave"), state, state_ns)
    here = state["state"][tick]
    steps = np.diff(asked, axis=0)
    next_to = (rows["sender"][1:] == rows["sender"][:-1]) & (np.diff(rows["sequence"]) == 1)
    steps = np.where(next_to[:, None] & np.isfinite(steps), steps, 0.0)
    engaged = np.cumsum(state["state"] == ENGAGED)[tick]
    still = np.diff(engaged) == 0  # a tick without a new sample moves too, and has no row
    still &= followed[tick[:-1]] & followed[tick[1:]]  # and of no state that was not recorded
    yielding = np.isin(here[1:], [state.value for state in State if state.name in YIELDING])
    pulled_in = np.maximum(steps, 0.0)[still].sum()
    let_out = np.maximum(-steps, 0.0)[still & ~yielding].sum()
    return float(pulled_in), float(let_out)
