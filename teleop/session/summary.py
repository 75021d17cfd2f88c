"""The summary of a session: the children's own summaries, put together and put in words."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from teleop.messages.messages import STAGE_NAMES
from teleop.session.state_machine import Reason


def read_child_summary(path: Path) -> dict[str, Any] | None:
    """Return the summary of a child, or None if it was killed before."""
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    return content


def has_run(loop: Mapping[str, Any] | None) -> bool:
    """Return whether the summary is of a loop that ran."""
    return bool(loop and loop["ticks"])


# reasons of a fault that started at the peer
PEER_REASONS = (
    Reason.PEER_SILENT,
    Reason.PEER_FAULT,
    Reason.PEER_LEFT,
    Reason.PEER_DECLINED,
    Reason.PEER_STOPPED,
    Reason.PEER_RESTARTED,
)
_PEER_REASON_TEXTS = tuple(reason.text for reason in PEER_REASONS)


def find_fault(summary: Mapping[str, Any]) -> str:
    """Return the fault of a session at its end; empty if none.

    Either its slave was never usable, or a fault without later engagement ended it.
    """
    loops = {role: summary.get(role) for role in ("slave", "master")}
    slave = loops["slave"]
    if (
        slave is not None
        and has_run(slave)
        and not any(slave["ticks_in"][state] for state in ("ready", "engaged", "fault"))
    ):
        return f"the slave was never usable: {slave['not_usable']}"
    faults = [
        (role, loop["ended_in"])
        for role, loop in loops.items()
        if loop is not None and has_run(loop) and loop["ended_in"]
    ]
    first_hand = [fault for fault in faults if fault[1] not in _PEER_REASON_TEXTS]
    for role, fault in (first_hand or faults)[:1]:
        return f"a fault of the {role} ended the session: {fault}"
    return ""


# flags of a gate in a session that is not engaged, or without intervention
ORDINARY_GATE_RESULTS = ("PASSED", "HELD", "NOT_ENGAGED", "STALE", "NOT_ENGAGED|STALE")


def format_summary(summary: Mapping[str, Any], with_loops: bool = True) -> list[str]:
    """Return the summary as lines of text; none of a loop that never ran.

    Without `with_loops` what a table of the loops' figures shows is left out.
    """
    out = []
    for role in ("slave", "master"):
        loop = summary.get(role)
        if role in summary and loop is None:
            out.append(f"{role:9} left no summary (killed?)")
        if loop is not None and has_run(loop):
            out += format_loop(loop) if with_loops else format_loop(loop)[2:]
    slave = summary.get("slave")
    if slave is not None and has_run(slave):
        out.append(f"force     {format_force_error(slave.get('force_error'))}")
    impair = summary.get("impair")
    if impair:
        out += format_impair_counts(impair)
    recorder = summary.get("record")
    if recorder:
        total = sum(recorder["messages"].values())
        out.append(
            f"recording {recorder['file']}: {total} messages, {recorder['missing']} missing, "
            f"at most {recorder['lag_max_s']:.1f} s behind"
        )
    elif "record" in summary:
        out.append("recording left no summary (killed?): its end is missing")
    return out


def format_loop(loop: Mapping[str, Any]) -> list[str]:
    """Return the summary of one loop: timing, link, session, gate."""
    rejected = sum(loop["rejected"].values())
    ticks = loop["ticks"] or 1
    engaged = loop["ticks_in"]["engaged"] / ticks * loop["seconds"]
    faults = loop["faults"]
    limits = {kind: n for kind, n in loop["gate"].items() if kind not in ORDINARY_GATE_RESULTS}
    out = [
        f"{loop['role']:9} {loop['rate_hz']:.1f} Hz over {loop['seconds']:.1f} s, "
        f"{loop['overruns']} overruns, latest tick {loop['lateness_max_ms']:.2f} ms, "
        f"work p50 {loop['work_us']['p50'] or 0:.0f} us, p99 {loop['work_us']['p99'] or 0:.0f} us",
        f"{'':9} received {loop['received']}, lost {loop['lost']}, rejected {rejected}; "
        f"engaged {engaged:.1f} s, "
        + (
            f"{len(faults)} fault{'s' * (len(faults) > 1)}, last: {faults[-1]}"
            if faults
            else "no fault"
        ),
    ]
    if limits:
        counts = ", ".join(
            f"{kind.lower()} {100 * n / ticks:.1f} %" for kind, n in sorted(limits.items())
        )
        out.append(f"{'':9} gate active: {counts} of the ticks")
    latency = loop["latency_ms"]
    if latency["n"]:
        out.append(
            f"latency   command to force p50 {latency['p50']:.2f} ms, p99 {latency['p99']:.2f} ms, "
            f"p99.9 {latency['p99_9']:.2f} ms ({latency['n']} round trips)"
        )
    if link := loop.get("link"):
        out += format_link(link)
    stages = loop.get("stages_us", {})
    whole = stages.get(STAGE_NAMES[-1])
    if whole and whole["n"]:
        medians = {name: stages[name]["p50"] * 1e-3 for name in STAGE_NAMES}
        quantiles = [whole[name] * 1e-3 for name in ("p50", "p99", "p99_9", "max")]
        out.append(
            f"latency   hand to force {format_latency(quantiles, medians)} "
            f"({whole['n']} commands answered in their own tick)"
        )
    return out


def format_link(link: Mapping[str, Any]) -> list[str]:
    """Return the health of a side's link over the run; none if nothing was measured."""
    trip, jitter = link["round_trip_ms"], link["jitter_ms"]
    if not trip["n"]:
        return []
    offset = ""
    if link["offset_ms"] is not None:
        clock = f"{link['offset_ms']:.3f} +- {link['uncertainty_ms']:.3f} ms"
        offset = f", offset of the peer's clock {clock}"
    line = (
        f"link      round trip p50 {trip['p50']:.2f} p99 {trip['p99']:.2f} ms, "
        f"jitter p50 {jitter['p50'] or 0:.2f} ms, loss {100 * link['loss']:.2f} %{offset}"
    )
    limits = [
        f"{what} for {link[key]:.1f} s"
        for key, what in (("scaled_s", "scaled down"), ("held_s", "held"))
        if link[key]
    ]
    return [line, *([f"{'':9} because of the link {', '.join(limits)}"] if limits else [])]


# how the stages of STAGE_NAMES, but for "all", are called in a line
_STAGE_LABELS = ("read", "link", "slave", "render")


def format_latency(quantiles_ms: Sequence[float], medians_ms: Mapping[str, float]) -> str:
    """Return the latency from hand to force, and the medians of its stages, as text.

    Parameters
    ----------
    quantiles_ms : sequence of 4 floats
        [ms] p50, p99, p99.9 and the largest of all stages together.
    medians_ms : mapping
        [ms] of each of `teleop.messages.messages.STAGE_NAMES`.
    """
    p50, p99, p99_9, largest = quantiles_ms
    stages = zip(_STAGE_LABELS, STAGE_NAMES[:-1], strict=True)
    budget = ", ".join(f"{word} {medians_ms[name]:.2f}" for word, name in stages)
    return f"p50 {p50:.2f} p99 {p99:.2f} p99.9 {p99_9:.2f} max {largest:.2f} ms: {budget}"


def format_force_error(error: Mapping[str, Any] | None) -> str:
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
    for way in ("to_slave", "to_master"):
        for topic, numbers in counts[way].items():
            text = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in numbers.items() if n)
            out.append(f"{way:9} {topic}: {text}")
    return out
