"""Run the operator's side: read the haptic device, command the slave, render the force.

  teleop master                                          a scripted hand, on this machine
  teleop master --config configs/demo.yaml --duration 30 --json master.json
  teleop master --set master.force.scale=0.1 --set master.device.reference.type=reaches

Without a slave the hand feels nothing. When the slave's states stop coming for longer than
`master.freshness`, the force fades; when anything else goes wrong, it is zero at once. It stays so
until the operator lets go of the engage switch and presses it again, and after an emergency stop
until that has been reset too (`teleop stop --reset`). A HID device that is unplugged may be plugged
in again. `teleop set` changes some settings while this runs.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from master import live, loop
from master.config import MasterConfig
from master.device import Device, DeviceFault, DeviceLost, HandState
from master.devices import open_device
from teleop.clock import STALL_NS, Grid, Tick, now_ns, quiet_garbage
from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.coupling import LEDGER_PERIOD_NS, Bilateral, ledger_message
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.launch.summary import loop_lines, trouble
from teleop.link import NEVER_NS, Counts, Link
from teleop.messages import Answer, Command, text_bytes
from teleop.meter import LoopMeter, in_words
from teleop.process import Stop, destination, seconds, supervised, write_summary
from teleop.realtime import enter_loop, go_realtime
from teleop.remote.door import Asked, Door, Wish
from teleop.run_config import RunConfig
from teleop.session import Reason, Session, State
from teleop.tell import tell
from teleop.topics import ANSWER, COMMAND, HAND, LEDGER, REPORT, STATE, Role


class Master:
    """The world around `loop.step`: one device, one link, and the counts.

    Attributes
    ----------
    error : TeleopError or None
        What ended the session, if it was not asked to end.
    """

    def __init__(
        self,
        config: MasterConfig,
        link: Link,
        device: Device,
        grid: Grid,
        bilateral: Bilateral = loop.DIRECT,
    ) -> None:
        self.error: TeleopError | None = None
        self.memory = loop.start(device.axes, now_ns())
        self._live, self._link, self._device = live.start(config), link, device
        self._door = Door(link)
        self._stop_words = ""  # who called for the last stop
        self._bilateral = bilateral
        self._ledger_due_ns = 0
        self._meter = LoopMeter(Role.MASTER, grid)
        self._verdicts: Counter[str] = Counter()
        self._start_ns = now_ns()
        self._said = self.memory.session
        self._away = ""  # why the device cannot be read, while it is looked for
        link.subscribe_latest(STATE, round(config.freshness * 1e9))

    def tick(self, tick: Tick) -> None:
        """Read, step, write, publish."""
        fault, hand, round_trip = Reason.NONE, None, 0
        try:
            hand = self._device.read((tick.stamp_ns - self._start_ns) * 1e-9)
            away = ""
        except DeviceLost as error:
            fault, away = Reason.DEVICE_FAULT, str(error)
        except DeviceFault as error:
            fault, away = self._device_failed(error), ""
        latest = self._link.latest(STATE)
        state, now = latest.message, now_ns()
        asked = self._asked(now)
        self._live, words = live.press(live.step(self._live, tick.dt), hand)
        if words:
            tell(self._link, Role.MASTER, self._said, f"set: {words}")

        def step(
            hand: HandState | None, fault: Reason, late_s: float = 0.0
        ) -> tuple[loop.Output, loop.Memory]:
            then = now_ns()
            return loop.step(
                self._live.config,
                self.memory,
                hand,
                state,
                latest.age_ns(then),
                then,
                tick.dt + late_s,
                fault,
                self._bilateral,
                asked.stop,
                asked.reset,
            )

        output, memory = step(hand, fault)
        late_ns = now_ns() - now
        if late_ns > STALL_NS:
            output, memory = step(hand, fault, late_ns * 1e-9)
        try:
            self._device.write(output.force)
        except DeviceFault as error:
            fault = self._device_failed(error)
            output, memory = step(None, fault)
        if output.answer_ns:
            round_trip = now_ns() - output.answer_ns
            self._meter.latency.add(round_trip)
        self.memory = memory
        self._link.publish(COMMAND, output.command)
        self._door.relay(Role.MASTER, memory.session, asked.words)
        if hand is not None:
            age = latest.age_ns(now)
            told = -1 if age == NEVER_NS else age
            message = loop.hand_message(memory, hand, output.force, told, round_trip)
            self._link.publish(HAND, message)
        self._publish_ledger(tick.stamp_ns)
        if memory.session != self._said:
            self._tell(memory.session)
        if away != self._away:
            self._tell_whereabouts(away)
        self._verdicts[str(output.verdict.name)] += 1
        self._report(tick.stamp_ns, latest.counts)
        self._meter.tick(memory.session, now_ns() - tick.stamp_ns, self._detail(memory.session))

    def close(self) -> None:
        """Take the force off the hand and tell the others; whatever happened before."""
        with suppress(DeviceFault):
            self._device.write((0.0,) * self._device.axes)
        self._link.publish(COMMAND, Command())
        tell(self._link, Role.MASTER, Session(), f"off: {self.error or 'ended'}")

    def summary(self) -> dict[str, Any]:
        """Return the run in numbers."""
        return self._meter.summary(self.memory.session, self._link.counts(), self._verdicts)

    def _device_failed(self, error: DeviceFault) -> Reason:
        self.error = self.error or TeleopError(f"haptic device: {error}")
        return Reason.DEVICE_FAULT

    def _tell(self, side: Session) -> None:
        self._said = side
        words = in_words(side.reason, self._detail(side))
        tell(self._link, Role.MASTER, side, f"{side.state.name.lower()}: {words}")

    def _detail(self, side: Session) -> str:
        """Return what the reason of a state is about; empty if there is no more to say."""
        if side.reason is Reason.STOP_CALLED:
            return self._stop_words
        return self._away if side.reason is Reason.DEVICE_FAULT else ""

    def _asked(self, now: int) -> Asked:
        """Return what other processes ask for, having changed the settings that they want."""
        asked = self._door(now, self.memory.session.stops)
        if asked.words and self._said.state is not State.STOPPED:  # the first caller's
            self._stop_words = asked.words
        for wish in asked.wishes:
            self._grant(wish)
        return asked

    def _grant(self, wish: Wish) -> None:
        """Change a setting, or say why not."""
        try:
            self._live, words = live.change(self._live, wish.key, wish.value)
        except UsageError as error:
            words, accepted = str(error), False
        else:
            accepted = True
            tell(self._link, Role.MASTER, self._said, f"set: {words}")
        answer = Answer(
            role=Role.MASTER,
            asker=wish.asker,
            asked=wish.asked,
            accepted=accepted,
            text=text_bytes(words),
        )
        self._link.publish(ANSWER, answer)

    def _tell_whereabouts(self, away: str) -> None:
        self._away = away
        back = "it is back; let go of everything, then engage"
        tell(self._link, Role.MASTER, self._said, f"haptic device: {away or back}")

    def _publish_ledger(self, stamp_ns: int) -> None:
        if stamp_ns >= self._ledger_due_ns:
            self._ledger_due_ns = stamp_ns + LEDGER_PERIOD_NS
            message = ledger_message(Role.MASTER, self.memory.port, self._device.axes)
            self._link.publish(LEDGER, message)

    def _report(self, stamp_ns: int, counts: Counts) -> None:
        report = self._meter.report(stamp_ns, self.memory.session, counts)
        if report is None:
            return
        self._link.publish(REPORT, report)
        try:
            self._link.check_peers()
        except PeerError as error:
            self.error = self.error or error


def run(master: Master, grid: Grid, stop_for: Callable[[str], None]) -> None:
    """Tick until told to stop; the hand is left without force however this ends."""
    try:
        with quiet_garbage():
            for tick in grid:
                master.tick(tick)
                if master.error:
                    stop_for(str(master.error))
    finally:
        master.close()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop master`."""
    add_config_arguments(parser)
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds")
    parser.add_argument(
        "--json", type=destination, metavar="FILE", help="write the summary to FILE"
    )


def main(args: argparse.Namespace) -> int:
    """Run the master; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, MasterConfig, "master", args.overrides)
    stop = Stop(args.duration)
    # before the link: its threads inherit the priority
    granted = go_realtime(shared.realtime)
    with ExitStack() as stack:
        # a master that is refused as the second one must not have touched the device
        link = stack.enter_context(Link(shared.link, shared.session, Role.MASTER))
        device = open_device(config.device)
        stack.callback(device.close)
        grid = Grid(shared.rate_hz, stop)
        master = Master(config, link, device, grid, shared.bilateral)
        enter_loop(granted, shared.realtime)
        run(master, grid, stop.request)
        summary = master.summary()
    summary |= {"stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    if not supervised():
        print("\n".join(loop_lines(summary)))
    if master.error:
        raise master.error
    if not supervised() and (ended := trouble({"master": summary})):
        raise TeleopError(ended)
    return 0
