"""Run an experiment: present each trial in a session, ask the observer, and keep the answer.

Settings that a running session ramps (`master.live_settings`, and the environment of a simulated
rig, `slave.live_settings`) and impairments of its network change within a session. All others
change between blocks, with a new session: the operator engages again, so nothing jumps in the hand.

The coupling is among these. Its two sides must change it between the same two messages: energy and
waves that are under way in another coupling are worth other forces. A difference of the sides is a
reason not to be engaged, so the operator would have to engage again in any case.
"""

import itertools
import json
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from master import live_settings
from master.devices.virtual import VirtualConfig
from slave.live_settings import is_live_key
from slave.simulation import environment
from teleop.errors import TeleopError, UsageError
from teleop.experiment.design import Design, Trial, Value
from teleop.experiment.trial_table import TrialTable, format_value
from teleop.impair.config import ImpairConfig
from teleop.launch.config import SessionConfig
from teleop.launch.console import KeyReader
from teleop.launch.session import Session, print_line
from teleop.link.bridge import send_request
from teleop.remote.client import BLOCK_S, MARK_BYTES, SessionClient, StateTimeoutError
from teleop.runtime.clock import now_ns
from teleop.session.state_machine import State

Observer = Callable[[Trial], str]  # asked after each trial; returns one of `Design.answers`
Settings = Mapping[str, Any]  # by dotted key of a config

ATTEMPTS_MAX = 10  # of a trial
_WAITING = frozenset((State.READY, State.CLUTCHED))  # for the operator
SCRIPTED_WAITS_MAX = 2  # in a row, for a scripted hand to engage: nobody can help it
RECORDINGS = "recordings"  # folder of the sessions' recordings, in that of the experiment
_IMPAIR = ("impair.to_slave.", "impair.to_master.")
GAP_S = 0.3  # [s] without a state of the slave: the trial is disturbed
_SETTLE_S = max(live_settings.SLEW_S, environment.SLEW_S) + 0.1


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A design, and what its conditions and stimuli are in a session.

    Parameters
    ----------
    name : str
        Of the experiment.
    design : Design
        Conditions, procedure, intervals.
    set_condition : callable
        Returns the settings of a condition; by default the factors are keys of the config.
    set_stimulus : callable
        Returns the settings in an interval of a trial, from 1. `trial.target` is the interval that
        has `trial.stimulus`. Only settings that can change while a session runs: `force.scale`,
        `operator.position_scale`, `operator.lock`, `impair.to_slave`, `impair.to_master`, and, as
        `slave.rig.joints.0.environment.stiffness`, numbers of a simulated environment.
    duration : float
        [s] of an interval.
    """

    name: str
    design: Design
    set_condition: Callable[[dict[str, Value]], Settings] = dict
    set_stimulus: Callable[[Trial, int], Settings] = lambda _trial, _interval: {}
    duration: float = 3.0


class KeyObserver:
    """Asks for a key of the terminal: the digit of an interval, or the first letter of an answer.

    Parameters
    ----------
    design : Design
        Whose answers are allowed.
    question : str
        Printed after each trial.

    Raises
    ------
    UsageError
        When asked: there is no terminal, or any answer is allowed.
    """

    def __init__(self, design: Design, question: str = "Which one?") -> None:
        self._keys = {answer[0]: answer for answer in design.answers}
        self._question = question

    def __call__(self, trial: Trial) -> str:
        """Return the answer to a trial; keys pressed before the question do not count."""
        if not self._keys:
            raise UsageError("KeyObserver: this design allows any answer; use a function")
        with KeyReader() as reader:  # drops what was typed before
            print_line(f"{trial.number}: {self._question} [{'/'.join(self._keys)}]")
            while reader.there:
                for key in reader.wait(1.0):
                    if key in self._keys:
                        return self._keys[key]
        raise UsageError("KeyObserver: no terminal to read keys from")


class ButtonObserver:
    """Waits for a button of the haptic device: the operator need not take a hand off it.

    Parameters
    ----------
    design : Design
        Whose answers are allowed.
    answers : mapping of int to str
        The answer that each button gives, as `{2: "1", 3: "2"}`; buttons are counted from 1, and
        must have no function in `master.device.buttons`.
    question : str
        Printed after each trial.

    Raises
    ------
    UsageError
        An answer is not allowed; when asked, that there is no session.
    """

    def __init__(
        self, design: Design, answers: Mapping[int, str], question: str = "Which one?"
    ) -> None:
        for answer in answers.values():
            if design.answers and answer not in design.answers:
                allowed = ", ".join(design.answers)
                raise UsageError(f"ButtonObserver: answer {answer!r}: allowed are {allowed}")
        if not answers:
            raise UsageError("ButtonObserver: no button has an answer")
        self._answers, self._question = dict(answers), question
        self.session: SessionClient | None = None  # set by `run_experiment`, of each trial

    def __call__(self, trial: Trial) -> str:
        """Return the answer to a trial; buttons pressed before the question do not count."""
        if self.session is None:
            raise UsageError("ButtonObserver: needs a session, whose device has the buttons")
        keys = ", ".join(f"button {n}: {answer}" for n, answer in self._answers.items())
        print_line(f"{trial.number}: {self._question} [{keys}]")
        return self._answers[self.session.wait_for_button(self._answers)]


def run_experiment(
    session: SessionClient | SessionConfig | str | Path | None,
    experiment: Experiment,
    participant: int,
    out: str | Path,
    observer: Observer,
    *,
    engage_timeout: float = 60.0,
    say: Callable[[str], None] = print_line,
) -> Path:
    """Run the trials of a participant that are not answered yet; return the table.

    Parameters
    ----------
    session : SessionClient, SessionConfig or path, or None
        A config: sessions are started as conditions need them, and recorded. A session that runs
        (`Session`, `join_session`): conditions may differ only in what it can change. None: no
        session; the observer is a simulation.
    participant : int
        From 1; decides the order of conditions.
    out : path
        Folder of the experiment: `design.json`, `participant-N.csv`, `recordings`.
    observer : callable
        Called with the trial after its last interval; returns the answer, such as "2".
    engage_timeout : float
        [s] that a trial waits for the operator to engage.
    say : callable
        Called with each line about progress.

    Raises
    ------
    UsageError
        The design was changed since earlier trials, or asks for what cannot be set.
    TeleopError
        A session cannot start; a trial was abandoned `ATTEMPTS_MAX` times in a row; or a scripted
        hand did not engage within `engage_timeout`, twice in a row. Calling again goes on with that
        trial.
    """
    design, folder = experiment.design, Path(out)
    description = {"name": experiment.name, "duration": experiment.duration, **design.describe()}
    sequence = design.begin(participant)
    stage = _Stage(session, experiment, folder / RECORDINGS, engage_timeout, say)
    with TrialTable(folder, participant, description, design.factors) as table, stage:
        table.replay(sequence)
        if table.rows:
            say(f"{table.path}: {len(table.rows)} trials are answered")
        procedure = type(design.procedure).__name__ if design.procedure else ""
        while not sequence.is_done:
            trial = sequence.choose_trial()
            attempts, begin_ns = _present(stage, trial, say)
            if isinstance(observer, ButtonObserver):
                observer.session = stage.session
            asked_s = time.monotonic()
            response = observer(trial)
            seconds = time.monotonic() - asked_s
            correct = sequence.judge(response)
            used = stage.session
            recording = used.recording if isinstance(used, Session) else None
            values = {
                "session": used.name if used else "",
                "procedure": procedure,
                "response": response,
                "correct": correct,
                "response_time_s": round(seconds, 4),
                "attempts": attempts,
                "recording": recording.name if recording else "",
                "begin_stamp_ns": begin_ns,
                "time": datetime.now().astimezone().isoformat(timespec="milliseconds"),
            }
            table.append(trial, values)
            sequence.record(response)
            stage.end_trial(trial, response)
    say(f"{table.path}: all {len(table.rows)} trials are answered")
    return table.path


def _present(stage: "_Stage", trial: Trial, say: Callable[[str], None]) -> tuple[int, int]:
    """Present a trial until it is undisturbed; return the attempts, and when it began [ns]."""
    waits = 0  # in vain, in a row
    for attempt in range(1, ATTEMPTS_MAX + 1):
        try:
            return attempt, stage.present(trial)
        except UsageError:
            raise
        except TeleopError as error:
            # whether only the operator was missing
            is_wait = isinstance(error, StateTimeoutError) and _WAITING.issuperset(error.states)
            waits = waits + 1 if is_wait else 0
            if waits == SCRIPTED_WAITS_MAX and stage.is_hand_scripted:
                raise TeleopError(
                    f"trial {trial.number}: {error}, {waits} times in a row: the scripted hand has "
                    "let go; see master.device.engage and engage_period; earlier trials are kept, "
                    "run the experiment again to go on with this one in a new session"
                ) from error
            say(f"trial {trial.number} is abandoned and repeated: {error}")
            reason = error
            stage.abandon(trial, str(error))
    raise TeleopError(f"trial {trial.number}: abandoned {ATTEMPTS_MAX} times; the last: {reason}")


class _Stage(AbstractContextManager["_Stage"]):
    """The session, if any, in which trials take place; started anew where a condition needs it."""

    def __init__(
        self,
        source: SessionClient | SessionConfig | str | Path | None,
        experiment: Experiment,
        folder: Path,
        engage_timeout: float,
        say: Callable[[str], None],
    ) -> None:
        self._experiment, self._folder, self._say = experiment, folder, say
        self._engage_timeout = engage_timeout
        self.session = source if isinstance(source, SessionClient) else None  # of the next trial
        self._config = None if isinstance(source, SessionClient) else source
        self._own: Session | None = None
        self._fixed: dict[str, Any] = {}  # settings that our session was started with
        self._applied: dict[str, Any] = {}  # settings that it was given since
        self._uses_impair = False
        if source is not None:
            self._check_settings()

    def __exit__(self, *exception: object) -> None:
        if self._own is not None:
            self._own.end()

    @property
    def is_hand_scripted(self) -> bool:
        """Whether it is known that no operator holds the device."""
        session = self.session
        return isinstance(session, Session) and isinstance(
            session.config.master.device, VirtualConfig
        )

    def present(self, trial: Trial) -> int:
        """Present all intervals of a trial; return when the first began [ns].

        Raises `TeleopError` if the session faulted or left engagement.
        """
        live, fixed = _split(self._experiment.set_condition(trial.condition))
        if self._config is not None and (self._own is None or fixed != self._fixed):
            self._start(fixed)
        if self.session is None:
            return now_ns()
        begin_ns = 0
        self.session.wait_for("engaged", self._engage_timeout)
        for interval in range(1, self._experiment.design.intervals + 1):
            self._apply({**live, **self._experiment.set_stimulus(trial, interval)})
            if interval == 1:
                begin_ns = now_ns()
                values = {**trial.condition, "stimulus": trial.stimulus, "target": trial.target}
                known = (f"{k}={format_value(v)}" for k, v in values.items() if v is not None)
                self._mark(f"trial {trial.number} begins: {', '.join(known)}")
            else:
                self._mark(f"trial {trial.number} interval {interval}")
            self._require_engagement(self.session, self._experiment.duration)
        return begin_ns

    def end_trial(self, trial: Trial, response: str) -> None:
        """Mark the end of an answered trial; it counts even if the session has ended meanwhile."""
        try:
            self._mark(f"trial {trial.number} ends: response={response}")
        except UsageError:
            raise
        except TeleopError as error:
            self._say(f"trial {trial.number}: is kept, but its end is not marked: {error}")

    def abandon(self, trial: Trial, reason: str) -> None:
        """Mark a trial as not to be used; end our session if it has failed.

        Raises `TeleopError` if it has failed, and is not ours to start again.
        """
        self._applied = {}
        if self.session is None:  # it could not start, and may the next time
            return
        try:
            self._mark(f"trial {trial.number} abandoned: {reason}")
        except UsageError:
            raise
        except TeleopError:
            if self._own is None:
                raise
            self._own.end()
            self._own = self.session = None

    def _check_settings(self) -> None:
        """Raise `UsageError` for settings that a session cannot have, before any trial."""
        experiment, first = self._experiment, self._experiment.design.begin(1).choose_trial()
        procedure = experiment.design.procedure
        key_sets = []
        for condition in experiment.design.conditions:
            live, fixed = _split(experiment.set_condition(condition))
            bounds = (None,) if procedure is None else procedure.bounds
            for interval, stimulus in itertools.product(
                range(1, experiment.design.intervals + 1), bounds
            ):
                trial = first._replace(condition=condition, stimulus=stimulus, target=interval)
                changed, refused = _split(experiment.set_stimulus(trial, interval))
                if refused:
                    raise UsageError(
                        f"set_stimulus: {next(iter(refused))} cannot change while a session runs; "
                        "make it a factor"
                    )
                key_sets.append({*live, *fixed, *changed})
                self._uses_impair |= any(key.startswith(_IMPAIR) for key in key_sets[-1])
                self._check_values(fixed, live | changed)
        for keys in key_sets:  # a setting would keep its value of another trial
            if missing := key_sets[0] ^ keys:
                raise UsageError(f"{min(missing)}: must be set in every condition and interval")

    def _check_values(self, fixed: dict[str, Any], live: dict[str, Any]) -> None:
        if self._config is not None:
            Session(self._config, self._add_impair({**fixed, **live}))  # checked, not started
        elif fixed:
            raise UsageError(
                f"{next(iter(fixed))}: cannot change while a session runs; give run_experiment the "
                "config, not the session"
            )
        elif self._uses_impair and _get_impair(self.session) is None:
            raise UsageError("impair: needs a Session of this program, with a section impair")

    def _add_impair(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return settings of a session, with a proxy if the experiment impairs its network."""
        if not self._uses_impair or Session(self._config).config.impair is not None:
            return settings
        return {"impair": {}, **settings}

    def _start(self, fixed: dict[str, Any]) -> None:
        if self._own is not None:
            self._own.end()
        self._own = self.session = None
        self._applied = {}
        self._say("a session starts; engage when it is ready")
        own = Session(self._config, self._add_impair(fixed), record=self._folder, say=self._say)
        own.start()
        self._own = self.session = own
        self._fixed = fixed

    def _apply(self, settings: Settings) -> None:
        """Make changed settings, and wait until ramps have ended."""
        changed = {
            k: settings[k] for k in settings if (k, settings[k]) not in self._applied.items()
        }
        if not changed or self.session is None:
            return
        impaired = {k: v for k, v in changed.items() if k.startswith(_IMPAIR)}
        for key in changed.keys() - impaired.keys():
            self.session.set(key, changed[key])
        config = _get_impair(self.session)
        if impaired and isinstance(self.session, Session) and config is not None:
            words = [f"{k.removeprefix('impair.')}={json.dumps(v)}" for k, v in impaired.items()]
            link = config.build_link_config(self.session.config.link)
            send_request(link, self.session.name, config.endpoint, "\n".join(["set", *words]))
        self._applied |= changed
        self._require_engagement(self.session, _SETTLE_S)

    def _require_engagement(self, session: SessionClient, seconds: float) -> None:
        """Let a time [s] pass; `TeleopError` unless the slave was engaged all the time."""
        heard_s = time.monotonic()
        for block in session.blocks(seconds):
            before_s, heard_s = heard_s, time.monotonic()
            if heard_s - before_s > BLOCK_S + GAP_S:
                raise TeleopError(f"no states of the slave for {heard_s - before_s:.2f} s")
            others = block["state"][block["state"] != State.ENGAGED]
            if len(others):
                raise TeleopError(f"the slave was {State(int(others[0])).name.lower()}")
        if time.monotonic() - heard_s > GAP_S:
            raise TeleopError("no states of the slave at the end of an interval")

    def _mark(self, text: str) -> None:
        if self.session is not None:
            line = "".join(letter for letter in text if letter.isprintable())
            self.session.mark(line.encode()[:MARK_BYTES].decode(errors="ignore"))


def _get_impair(session: SessionClient | None) -> ImpairConfig | None:
    return session.config.impair if isinstance(session, Session) else None


def _split(settings: Settings) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the settings that can change while a session runs, and the others; full keys."""
    full = {f"master.{k}" if k in live_settings.KEYS else k: v for k, v in settings.items()}
    live = {
        key: value
        for key, value in full.items()
        if key.removeprefix("master.") in live_settings.KEYS
        or key.startswith(_IMPAIR)
        or is_live_key(key)
    }
    return live, {key: value for key, value in full.items() if key not in live}
