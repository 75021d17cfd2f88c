"""The emergency stop of a session, from any terminal that reaches its endpoints.

  teleop stop                      emergency stop: no force, motors hold, until reset
  teleop stop --config rig.yaml    for the session of this config
  teleop stop --watch              stop when this process ends, freezes or is disconnected
  teleop stop --reset              reset the stop; the operator must release and engage again

On a machine where a side or a `teleop stop --watch` of the session runs, the stop goes to it
directly and does not depend on the network being free for new connections. So on a machine that has
neither, leave `teleop stop --watch` running. Otherwise the stop connects to both sides.

Exit code 0 when every connected side reports that it has stopped, or has just ended in order; 1,
with its name, when one does not or hangs. With --watch, Enter stops at once; `q`, then Enter, ends
the watch without a stop.
"""

import argparse

from teleop.config.options import add_options
from teleop.errors import TeleopError, UsageError
from teleop.remote.stop_socket import (
    ENDED,
    SILENT,
    STOPPED,
    LocalAnswers,
    list_sessions_with_sockets,
    request_local,
)
from teleop.session import running_sessions

DEFAULT_REASON = "teleop stop"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop stop`."""
    add_options(parser, "--session", "--config", "--set", "--insecure")
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--reset", action="store_true", help="reset an emergency stop")
    group.add_argument("--watch", action="store_true", help="stop when this process ends")
    parser.add_argument(
        "--why", default="", metavar="TEXT", help="reason, sent and recorded with it"
    )


def main(args: argparse.Namespace) -> int:
    """Stop a session, reset the stop, or watch the session; returns the exit code."""
    session, reason = _find_session(args), args.why or DEFAULT_REASON
    local: dict[str, str] = {}
    if not args.watch:
        answers = request_local(session, args.reset, reason)
        local = answers.states
        if _is_complete(answers, args.reset):
            return _report_states(local, args.reset)
    # slow to import; what is above does not need it
    from teleop.runtime.realtime import use_ordinary_scheduling

    with use_ordinary_scheduling():
        from teleop.remote import stop_over_link
        from teleop.session.config import RunConfig, read_config

    if args.watch:
        return stop_over_link.watch_session(read_config(args).load(RunConfig), args.why)
    try:
        config = read_config(args).load(RunConfig)
        if local and config.session != session:
            raise UsageError(
                f"the endpoints of session {session!r} are not known here; name its config: "
                "teleop stop --config FILE"
            )
        states = local | stop_over_link.request_over_link(config, args.reset, reason)
    except TeleopError as error:
        if not local:
            raise
        print(f"over the network: {error}")
        states = local
    if not states and not _has_session_name(args):
        raise TeleopError(
            "no session of yours runs on this machine; for one on another machine name its config: "
            "teleop stop --config FILE"
        )
    if not states:
        raise TeleopError(f"session {config.session!r}: no answer from master or slave")
    return _report_states(states, args.reset)


def _find_session(args: argparse.Namespace) -> str:
    """Return the name of the session that a command line means; empty if it names none."""
    if args.session:
        return str(args.session)
    if _has_session_name(args):
        # slow to import, and not needed without options
        from teleop.config.loading import ConfigDocument

        stated = ConfigDocument.read(args.config, args.overrides).tree.get("session")
        name = stated if isinstance(stated, str) else ""
        entry = None if name else running_sessions.find_session(config=args.config)
        return entry.session if entry else name or "demo"
    names = list_sessions_with_sockets() | {
        entry.session for entry in running_sessions.list_sessions()
    }
    if len(names) > 1:
        raise UsageError(
            f"{len(names)} sessions are running: {', '.join(sorted(names))}; name one with "
            "--session"
        )
    return min(names, default="")


def _has_session_name(args: argparse.Namespace) -> bool:
    """Return whether a command line says which session it means."""
    return bool(args.session or args.config or args.overrides)


def _is_complete(answers: LocalAnswers, is_reset: bool) -> bool:
    """Return whether the answers from this machine are those of the whole session."""
    answered = any(state != SILENT for state in answers.states.values())
    is_whole = answers.are_direct or not is_reset
    return answered and is_whole and not answers.has_silent_peer


def _report_states(states: dict[str, str], is_reset: bool) -> int:
    """Print the states of the sides by their names; return 0, or raise if one did not obey."""
    for side, state in states.items():
        print(f"{side:9} {state}")
    silent = [side for side, state in states.items() if state == SILENT]
    remaining = {side: state for side, state in states.items() if state != ENDED}
    failed = [side for side, state in remaining.items() if (state == STOPPED) == is_reset]
    if silent:
        doubt = "be stopped" if is_reset else "NOT have stopped: use the switch of its hardware"
        raise TeleopError(f"no answer from the {' and the '.join(silent)}, which may {doubt}")
    if failed:
        failure = "is still stopped; its terminal shows why" if is_reset else "has NOT stopped"
        raise TeleopError(f"the {' and the '.join(failed)} {failure}")
    if not remaining:
        print("the session has ended")
    elif is_reset:
        print("release the engage switch, then press it again")
    return 0
