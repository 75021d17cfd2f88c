"""Record a session to a file: every message of every topic, as it crossed the link.

  teleop record                                      the session of the defaults, until Ctrl-C
  teleop record --config configs/demo.yaml --out /data/bench --duration 60

The recorder only listens: it may start at any time, be slow, or be killed, without effect on the
loops. The file (MCAP) opens in Foxglove, PlotJuggler, Rerun and Python: see docs/recordings.md.
"""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

from teleop.clock import now_ns
from teleop.link import Link
from teleop.options import add_options
from teleop.process import Stop, folder, let_loops_first, supervised, write_summary
from teleop.recording.config import RecordConfig
from teleop.recording.writer import RecordingWriter
from teleop.run_config import load_section
from teleop.topics import TOPICS, Role


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop record`."""
    add_options(parser, "--session", "--config", "--set", "--insecure", "--duration", "--json")
    parser.add_argument(
        "--out", type=folder, metavar="DIR", help="record into DIR (default recordings)"
    )


def main(args: argparse.Namespace) -> int:
    """Record until told to stop; returns the exit code."""
    run, config = load_section(args, RecordConfig, "record")
    if args.out:
        config = dataclasses.replace(config, directory=args.out)
    config_text = args.config.read_text() if args.config else ""
    let_loops_first()
    stop = Stop(args.duration)
    with Link(run.link, run.session, Role.RECORDER) as link:
        listener = link.listen(TOPICS)
        writer = RecordingWriter(
            config, run.session, now_ns(), config_text, args.overrides, link.insecure
        )
        if link.warning:
            print(link.warning, flush=True)
        print(f"recording session {run.session!r} to {writer.path}", flush=True)
        try:
            with writer:
                stopping = False
                while not stopping:
                    time.sleep(config.drain_s)
                    stopping = (
                        stop()
                    )  # checked before the last read, which gets all earlier messages
                    messages = listener.drain()
                    writer.note_dropped({topic.name: listener.dropped(topic) for topic in TOPICS})
                    writer.write(messages, now_ns())
        finally:
            summary = summary_of(writer)
            write_summary(args.json, summary)
            if not supervised():
                print("\n".join(lines(summary)))
    return 0


def summary_of(writer: RecordingWriter) -> dict[str, Any]:
    """Return the summary as a tree."""
    return {
        "file": str(writer.path),
        "seconds": (writer.last_ns - writer.first_ns) * 1e-9,
        "messages": dict(writer.messages),
        "gaps": writer.gaps.by_topic(),
        "dropped": dict(writer.dropped),
        "bytes": writer.bytes_written,
    }


def lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as text."""
    size_MB, seconds = summary["bytes"] / 1e6, summary["seconds"]
    out = [f"recorded {Path(summary['file'])}: {seconds:.1f} s, {size_MB:.1f} MB"]
    for topic, count in summary["messages"].items():
        lost = summary["gaps"][topic]
        rate = f"{(count - 1) / seconds:7.1f}/s" if seconds > 0 else ""
        out.append(f"  {topic:10} {count:9} messages {rate}" + (f", {lost} lost" if lost else ""))
    if summary["dropped"]:
        dropped = ", ".join(f"{count} {topic}" for topic, count in summary["dropped"].items())
        out.append(f"  dropped because the recorder was too slow: {dropped}; use a faster disk")
    if not summary["messages"]:
        out.append("  no messages in this session")
    return out
