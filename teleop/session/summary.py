"""The summary of a session: what each loop measured of itself, put together and put in words."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypedDict

from teleop.link.health import LinkSummary
from teleop.messages.messages import STAGE_NAMES
from teleop.messages.topics import Role
from teleop.runtime.clock import Percentiles
from teleop.session.state_machine import PEER_REASONS, DetailedReason, State


class ForceError(TypedDict):
    """Error of the estimated force; see `estimator.online.force_error.Score.summary`."""

    samples: int
    full_scale_N: float  # largest true force
    pulled: bool  # whether that stands out of the noise, so that a percentage says something
    rmse_N: float
    mean_N: float
    max_N: float
    rmse_percent: float  # of full scale
    mean_percent: float
    max_percent: float
    inside_interval: float  # fraction of the samples


@dataclass(frozen=True, slots=True)
class RigSummary:
    """What only a slave measures."""

    force_error: ForceError | None  # of the estimates; None without sensors at the tip
    rig: Mapping[str, int | float | str]  # entries of the rig itself
    friction: tuple[str, ...] = ()  # of tendons that adapt, at the end; what was said of them


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSummary:
    """Figures of one loop over a whole run."""

    role: Role
    seconds: float  # [s] from the first tick to the last
    ticks: int
    rate_hz: float
    overruns: int
    lateness_max_ms: float
    work_us: Percentiles  # of a tick
    answer_us: Percentiles  # from the start of a tick to its message on the link
    without_rig_us: Percentiles  # work, without the computation of a simulated rig
    latency_ms: Percentiles  # from command to force
    stages_us: Mapping[str, Percentiles]  # from hand to force, by `STAGE_NAMES`
    received: int
    lost: int
    overwritten: int
    rejected: Mapping[str, int]  # by `REJECTION_COUNTERS`
    unknown: int
    delayed: int
    clock_jumps: int
    restarts: int
    gate: Mapping[str, int]  # ticks by the names of its flags
    ticks_in: Mapping[State, int]
    faults: tuple[DetailedReason, ...]
    final_state: State
    reason: DetailedReason  # of the final state
    not_usable: DetailedReason  # why it was last not usable
    ended_in: DetailedReason | None  # the fault or stop that ended it
    link: LinkSummary
    rig: RigSummary | None = None  # of a slave
    degraded: DetailedReason | None = None  # why force and motion were limited, besides the link
    degraded_ticks: int = 0
    stopped: str = ""  # why the process ended
    realtime: tuple[str, ...] = ()  # what the system granted

    @property
    def engaged_s(self) -> float:
        """Time [s] in ENGAGED."""
        return self.ticks_in[State.ENGAGED] / (self.ticks or 1) * self.seconds

    @property
    def degraded_s(self) -> float:
        """Time [s] in ENGAGED with force and motion limited."""
        return self.degraded_ticks / (self.ticks or 1) * self.seconds

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON file; the inverse of `from_json`."""
        out: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "rig":
                out |= {} if value is None else _to_plain(value)
            else:
                out[field.name] = _to_plain(value)
        out["ended_in"], out["degraded"] = out["ended_in"] or "", out["degraded"] or ""
        return out

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "LoopSummary":
        """Return the summary that `to_json` has made plain."""
        values = dict(content)
        rig = None
        if "rig" in values:
            friction = tuple(values.pop("friction"))
            rig = RigSummary(values.pop("force_error"), values.pop("rig"), friction)
        link = dict(values["link"])
        for name in ("round_trip_ms", "jitter_ms"):
            link[name] = Percentiles(**link[name])
        for name in ("work_us", "answer_us", "without_rig_us", "latency_ms"):
            values[name] = Percentiles(**values[name])
        for name in ("reason", "not_usable"):
            values[name] = DetailedReason.parse(values[name])
        ended_in, degraded = values["ended_in"], values["degraded"]
        return cls(**values | {
            "role": Role[values["role"].upper()],
            "stages_us": {name: Percentiles(**item) for name, item in values["stages_us"].items()},
            "ticks_in": {State[name.upper()]: n for name, n in values["ticks_in"].items()},
            "faults": tuple(DetailedReason.parse(text) for text in values["faults"]),
            "final_state": State[values["final_state"].upper()],
            "ended_in": DetailedReason.parse(ended_in) if ended_in else None,
            "degraded": DetailedReason.parse(degraded) if degraded else None,
            "link": LinkSummary(**link),
            "rig": rig,
            "realtime": tuple(values["realtime"]),
        })  # fmt: skip


def _to_plain(value: Any) -> Any:
    """Return a value of a summary as JSON has it."""
    if isinstance(value, DetailedReason):
        return value.text
    if isinstance(value, Role | State):
        return value.name.lower()
    if is_dataclass(value):
        return {field.name: _to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {_to_plain(key): _to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_to_plain(item) for item in value]
    return value


ChildSummary = LoopSummary | Mapping[str, Any] | None
"""Of a loop, or of another process; None of one that was killed before it left any."""

LOOPS = ("slave", "master")


@dataclass(frozen=True, slots=True)
class SessionSummary:
    """Summary of `teleop run`."""

    children: Mapping[str, ChildSummary]  # of its processes, by name
    reason: str = ""  # why it ended
    exit_code: int = 0

    @property
    def slave(self) -> LoopSummary:
        """Of the slave; `LookupError` if it left none."""
        return self._get_loop("slave")

    @property
    def master(self) -> LoopSummary:
        """Of the master; `LookupError` if it left none."""
        return self._get_loop("master")

    def _get_loop(self, name: str) -> LoopSummary:
        loop = self.children.get(name)
        if isinstance(loop, LoopSummary):
            return loop
        raise LookupError(f"the {name} left no summary")

    @property
    def loops(self) -> list[LoopSummary]:
        """Of the slave and the master, of those that ran."""
        summaries = [self.children.get(name) for name in LOOPS]
        return [loop for loop in summaries if isinstance(loop, LoopSummary) and loop.ticks]

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON file."""
        children = {
            name: child.to_json() if isinstance(child, LoopSummary) else child
            for name, child in self.children.items()
        }
        return {**children, "reason": self.reason, "exit_code": self.exit_code}


def read_child_summary(name: str, path: Path) -> ChildSummary:
    """Return the summary of the child `name`, or None if it was killed before."""
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    return LoopSummary.from_json(content) if name in LOOPS else content


def find_fault(loops: Iterable[LoopSummary]) -> str:
    """Return the fault of a session at its end; empty if none.

    Either its slave was never usable, or a fault without later engagement ended it.

    `loops` are of one or both sides, the slave first; one that never ran has no fault.
    """
    ran = [loop for loop in loops if loop.ticks]
    for loop in ran:
        usable = any(loop.ticks_in[s] for s in (State.READY, State.ENGAGED, State.FAULT))
        if loop.role is Role.SLAVE and not usable:
            return f"the slave was never usable: {loop.not_usable.text}"
    ends = [(loop.role, loop.ended_in) for loop in ran if loop.ended_in is not None]
    own_faults = [(role, end) for role, end in ends if end.reason not in PEER_REASONS]
    for role, end in (own_faults or ends)[:1]:
        return f"a fault of the {role.name.lower()} ended the session: {end.text}"
    return ""


# flags of a gate in a session that is not engaged, or without intervention
ORDINARY_GATE_RESULTS = ("PASSED", "HELD", "NOT_ENGAGED", "STALE_STATE", "NOT_ENGAGED|STALE_STATE")


def format_summary(summary: SessionSummary, with_loops: bool = True) -> list[str]:
    """Return the summary as lines of text; none of a loop that never ran.

    Without `with_loops` what a table of the loops' figures shows is left out.
    """
    out, children = [], summary.children
    for name in LOOPS:
        loop = children.get(name)
        if isinstance(loop, LoopSummary) and loop.ticks:
            out += format_loop(loop) if with_loops else format_loop(loop)[2:]
        elif name in children and loop is None:
            out.append(f"{name:9} left no summary (killed?)")
    for loop in summary.loops:
        out += format_rig(loop)
    impair, recorder = children.get("impair"), children.get("record")
    if isinstance(impair, Mapping):
        out += format_impair_counts(impair)
    if isinstance(recorder, Mapping):
        total = sum(recorder["messages"].values())
        out.append(
            f"recording {recorder['file']}: {total} messages, {recorder['missing']} missing, "
            f"at most {recorder['lag_max_s']:.1f} s behind"
        )
    elif "record" in children:
        out.append("recording left no summary (killed?): its end is missing")
    return out


def build_loop_figures(loop: LoopSummary) -> dict[str, str]:
    """Return the main figures of one loop as text, by their names."""
    return {
        "rate": f"{loop.rate_hz:.1f} Hz",
        "duration": f"{loop.seconds:.1f} s",
        "engaged": f"{loop.engaged_s:.1f} s",
        "overruns": str(loop.overruns),
        "latest tick": f"{loop.lateness_max_ms:.2f} ms",
        "work, median": f"{loop.work_us.p50 or 0:.0f} us",
        "work, 99 %": f"{loop.work_us.p99 or 0:.0f} us",
        "received": str(loop.received),
        "lost": str(loop.lost),
        "rejected": str(sum(loop.rejected.values())),
        "faults": str(len(loop.faults)),
        "last fault": loop.faults[-1].text if loop.faults else "none",
    }


def format_loop(loop: LoopSummary) -> list[str]:
    """Return the summary of one loop: its main figures in two lines, then gate, latency, link."""
    role, figures = loop.role.name.lower(), build_loop_figures(loop)
    plural = "s" * (len(loop.faults) > 1)
    faults = f"{figures['faults']} fault{plural}, last: {figures['last fault']}"
    out = [
        f"{role:9} {figures['rate']} over {figures['duration']}, {figures['overruns']} overruns, "
        f"latest tick {figures['latest tick']}, work p50 {figures['work, median']}, "
        f"p99 {figures['work, 99 %']}",
        f"{'':9} received {figures['received']}, lost {figures['lost']}, "
        f"rejected {figures['rejected']}; engaged {figures['engaged']}, "
        + (faults if loop.faults else "no fault"),
    ]
    ticks = loop.ticks or 1
    limits = {kind: n for kind, n in loop.gate.items() if kind not in ORDINARY_GATE_RESULTS}
    if limits:
        counts = ", ".join(
            f"{kind.lower()} {100 * n / ticks:.1f} %" for kind, n in sorted(limits.items())
        )
        out.append(f"{'':9} gate active: {counts} of the ticks")
    if loop.degraded:
        out.append(
            f"{'':9} force and motion limited for {loop.degraded_s:.1f} s: {loop.degraded.text}"
        )
    latency = loop.latency_ms
    if latency.n:
        out.append(
            f"latency   command to force p50 {latency.p50:.2f} ms, p99 {latency.p99:.2f} ms, "
            f"p99.9 {latency.p99_9:.2f} ms ({latency.n} round trips)"
        )
    out += format_link(loop.link)
    total = loop.stages_us[STAGE_NAMES[-1]]
    if total.n:
        medians = {name: (loop.stages_us[name].p50 or 0.0) * 1e-3 for name in STAGE_NAMES}
        quantiles = [
            (value or 0.0) * 1e-3 for value in (total.p50, total.p99, total.p99_9, total.max)
        ]
        out.append(
            f"latency   hand to force {format_latency(quantiles, medians)} "
            f"({total.n} commands answered in their own tick)"
        )
    return out


def format_rig(loop: LoopSummary) -> list[str]:
    """Return the force error of a slave, and K that has adapted, as lines; none of a master."""
    if loop.rig is None:
        return []
    friction = [f"friction  {text}" for text in loop.rig.friction]
    return [f"force     {format_force_error(loop.rig.force_error)}", *friction]


def format_link(link: LinkSummary) -> list[str]:
    """Return the health of a side's link over the run; none if nothing was measured."""
    trip = link.round_trip_ms
    if not trip.n:
        return []
    offset = ""
    if link.offset_ms is not None:
        clock = f"{link.offset_ms:.3f} +- {link.uncertainty_ms:.3f} ms"
        offset = f", offset of the peer's clock {clock}"
    line = (
        f"link      round trip p50 {trip.p50:.2f} p99 {trip.p99:.2f} ms, "
        f"jitter p50 {link.jitter_ms.p50 or 0:.2f} ms, loss {100 * link.loss:.2f} %{offset}"
    )
    limits = [
        f"{effect} for {seconds:.1f} s"
        for seconds, effect in ((link.scaled_s, "scaled down"), (link.held_s, "held"))
        if seconds
    ]
    return [line, *([f"{'':9} because of the link {', '.join(limits)}"] if limits else [])]


# how the stages of STAGE_NAMES, but for "all", are called in a line
_STAGE_LABELS = ("read", "link", "slave", "render")


def format_latency(quantiles_ms: Sequence[float], medians_ms: Mapping[str, float]) -> str:
    """Return the latency from hand to force, and the medians of its stages, as text.

    `quantiles_ms` are p50, p99, p99.9 and the largest of all stages together, `medians_ms` those of
    each of `teleop.messages.messages.STAGE_NAMES`.
    """
    p50, p99, p99_9, largest = quantiles_ms
    stages = zip(_STAGE_LABELS, STAGE_NAMES[:-1], strict=True)
    budget = ", ".join(f"{word} {medians_ms[name]:.2f}" for word, name in stages)
    return f"p50 {p50:.2f} p99 {p99:.2f} p99.9 {p99_9:.2f} max {largest:.2f} ms: {budget}"


def format_force_error(error: ForceError | None) -> str:
    """Return one line on the force error, or on its absence.

    No percentage if the full scale is close to the sensors' noise.
    """
    if error is None:
        return "no distal tension measured to compare the estimate with"
    if not error["pulled"]:
        return (
            f"nothing was pulled: largest true force {error['full_scale_N']:.1f} N; "
            f"RMSE {error['rmse_N']:.3f} N, mean {error['mean_N']:.3f} N, "
            f"max {error['max_N']:.3f} N; "
            f"inside its interval {100 * error['inside_interval']:.1f} % of the time"
        )
    return (
        f"RMSE {error['rmse_N']:.3f} N ({error['rmse_percent']:.1f} %), "
        f"mean {error['mean_N']:.3f} N, max {error['max_N']:.3f} N ({error['max_percent']:.1f} %) "
        f"of {error['full_scale_N']:.1f} N; "
        f"inside its interval {100 * error['inside_interval']:.1f} % of the time"
    )


def format_impair_counts(counts: Mapping[str, Any]) -> list[str]:
    """Return the message counts of a proxy, one line per topic."""
    out = []
    for direction in ("to_slave", "to_master"):
        for topic, numbers in counts[direction].items():
            text = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in numbers.items() if n)
            out.append(f"{direction:9} {topic}: {text}")
    return out
