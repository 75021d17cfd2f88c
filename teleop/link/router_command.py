"""Run a router: one place where the processes of many sessions meet.

  teleop router                                       on this machine, at 127.0.0.1:7450
  teleop router --session room-1 --session room-2 --listen 10.0.0.5:7450 --keys router-keys
  teleop router --config ward.yaml                    at `link.routers` of the sessions' config
  teleop router --listen 192.0.2.1:7450 --connect 198.51.100.1:7450 --keys router-keys

Master, slave, recorder and viewer of a session then connect to the router, not to each other: only
the router's port must be open, and a machine behind a firewall or NAT needs no port at all:

  link:
    routers: ["10.0.0.5:7450"]     # several: the first that answers, and the next when it is lost
    keys: console-keys

Any number of sessions share a router (`router.sessions`, or `--session` for each; by default the
config's). Their names keep them apart: every key begins with the name, and a router forwards a
message only to who subscribes to its key, and only if the certificate of its sender may send it: a
viewer's sends no commands, and what is of no session named is refused. `--session all` serves any
session, and leaves the roles to the processes themselves. A second master or slave of a session is
refused as without a router.

Routers connect to each other with `--connect`: one on each side of a wide-area network, so that
each site goes on talking within itself when the line is cut.

Off loopback a router needs keys of its own, which prove to every process that it is yours:

  teleop keys issue authority --session all --role router --out router-keys

It says which processes come and go. It must be there when they start; when it is started again they
come back by themselves, into holding, never into motion. See docs/topologies.md.
"""

import argparse
import dataclasses
import queue
from pathlib import Path

from teleop.config.loading import load
from teleop.config.options import add_option, add_options
from teleop.errors import UsageError
from teleop.link import LinkConfig
from teleop.link.router import Router, format_zenohd_config
from teleop.link.router_config import ALL, DEFAULT_ENDPOINT, RouterConfig
from teleop.messages.topics import Role, format_role
from teleop.runtime.process import StopCondition, write_summary
from teleop.runtime.realtime import request_realtime
from teleop.security.identity import ALL_SESSIONS
from teleop.session.config import RunConfig

_POLL_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop router`."""
    add_option(
        parser,
        "--session",
        action="append",
        default=[],
        help="served, may be repeated (default router.sessions or the config's); all = any",
    )
    for name, text in (
        (
            "--listen",
            f"of this machine, may be repeated (default link.routers, or {DEFAULT_ENDPOINT})",
        ),
        ("--connect", "of another router, may be repeated"),
    ):
        parser.add_argument(name, action="append", default=[], metavar="HOST:PORT", help=text)
    parser.add_argument("--keys", type=Path, metavar="DIR", help="folder of its keys (link.keys)")
    parser.add_argument(
        "--zenohd", action="store_true", help="print these settings as a config of zenohd, and end"
    )
    add_options(parser, "--config", "--set", "--insecure", "--duration", "--json")


def main(args: argparse.Namespace) -> int:
    """Run the router until told to stop; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = build_router_config(args, shared)
    link = build_router_link(shared.link, config, args.keys)
    sessions = [ALL_SESSIONS if name == ALL else name for name in config.sessions]
    if args.zenohd:
        print(format_zenohd_config(link, sessions, list(config.listen), list(config.connect)))
        return 0
    stop = StopCondition(args.duration)
    granted = request_realtime(
        shared.realtime
    )  # before the router: its threads inherit the priority
    changes: queue.SimpleQueue[tuple[str, Role, bool]] = queue.SimpleQueue()
    seen: set[str] = set()
    with Router(link, sessions, config.listen, config.connect, lambda *change: changes.put(change)):
        print(_format_start_message(config, link), flush=True)
        while not stop():
            try:
                session, role, came = changes.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            seen.add(session)
            print(
                f"session {session}: {format_role(role)} {'joined' if came else 'left'}", flush=True
            )
    summary = {"sessions": sorted(seen), "stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    print(f"router ended ({stop.reason}): {len(seen)} sessions seen")
    return 0


def build_router_config(args: argparse.Namespace, shared: RunConfig) -> RouterConfig:
    """Return what the router serves and where, by options, config or defaults.

    `UsageError` if an option is wrong.
    """
    config = load(args.config, RouterConfig, "router", args.overrides)
    try:
        return RouterConfig(
            sessions=tuple(args.session) or config.sessions or (shared.session,),
            listen=tuple(args.listen)
            or config.listen
            or shared.link.routers
            or (DEFAULT_ENDPOINT,),
            connect=tuple(args.connect) or config.connect,
        )
    except ValueError as error:
        raise UsageError(f"--{error}") from error


def build_router_link(link: LinkConfig, config: RouterConfig, keys: Path | None) -> LinkConfig:
    """Return the link of the router; `UsageError` if it must have keys and has none."""
    ends = (*config.listen, *config.connect)
    try:
        return dataclasses.replace(link, routers=ends, keys=keys or link.keys)
    except ValueError as error:
        raise UsageError(f"router: {str(error).partition(': ')[2]}") from error


def _format_start_message(config: RouterConfig, link: LinkConfig) -> str:
    ends = ", ".join(config.listen)
    text = f'router at {ends}; sessions find it by link.routers: ["{config.listen[0]}"]'
    text += f"; serves {', '.join(config.sessions)}"
    if config.connect:
        text += f"; connects to {', '.join(config.connect)}"
    return text + ("; INSECURE: plaintext, no keys" if link.insecure else "")
