"""Run the operator's side: read the haptic device, command the slave, render the force.

  teleop master                                          a scripted hand, on this machine
  teleop master --config configs/demo.yaml --duration 30 --json master.json
  teleop master --set master.force.scale=0.1 --set master.device.reference.type=reaches

Without a slave the hand feels nothing. When the slave's states stop coming for longer than
`master.freshness`, or anything else goes wrong, the force is zero at once and stays so until the
operator lets go of the engage switch and presses it again.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from master import loop
from master.config import MasterConfig
from master.device import Device, DeviceFault
from master.devices import open_device
from teleop.clock import Grid, Tick, now_ns, quiet_garbage
from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.errors import PeerError, TeleopError
from teleop.launch.summary import loop_lines
from teleop.link import NEVER_NS, Counts, Link
from teleop.messages import Command
from teleop.meter import LoopMeter
from teleop.process import Stop, destination, go_realtime, seconds, supervised, write_summary
from teleop.run_config import RunConfig
from teleop.session import Reason, Session
from teleop.tell import tell
from teleop.topics import COMMAND, HAND, REPORT, STATE, Role


class Master:
    """The world around `loop.step`: one device, one link, and the counts.

    Attributes
    ----------
    error : TeleopError or None
        What ended the session, if it was not asked to end.
    """

    def __init__(self, config: MasterConfig, link: Link, device: Device, grid: Grid) -> None:
        self.error: TeleopError | None = None
        self.memory = loop.start(device.axes, now_ns())
        self._config, self._link, self._device = config, link, device
        self._meter = LoopMeter(Role.MASTER, grid)
        self._verdicts: Counter[str] = Counter()
        self._start_ns = now_ns()
        self._said = self.memory.session
        link.subscribe_latest(STATE)

    def tick(self, tick: Tick) -> None:
        """Read, step, write, publish."""
        fault, hand, round_trip = Reason.NONE, None, 0
        try:
            hand = self._device.read((tick.stamp_ns - self._start_ns) * 1e-9)
        except DeviceFault as error:
            fault = self._device_failed(error)
        latest = self._link.latest(STATE)
        state, now = latest.message, now_ns()
        age = latest.age_ns(now)
        output, memory = loop.step(self._config, self.memory, hand, state, age, now, tick.dt, fault)
        try:
            self._device.write(output.force)
        except DeviceFault as error:
            fault = self._device_failed(error)
            output, memory = loop.step(
                self._config, self.memory, None, state, age, now, tick.dt, fault
            )
        if output.answer_ns:
            round_trip = now_ns() - output.answer_ns
            self._meter.latency.add(round_trip)
        self.memory = memory
        self._link.publish(COMMAND, output.command)
        if hand is not None:
            told = -1 if age == NEVER_NS else age
            message = loop.hand_message(memory, hand, output.force, told, round_trip)
            self._link.publish(HAND, message)
        if memory.session != self._said:
            self._tell(memory.session)
        self._verdicts[str(output.verdict.name)] += 1
        self._report(tick.stamp_ns, latest.counts)
        self._meter.tick(memory.session, now_ns() - tick.stamp_ns)

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
        tell(self._link, Role.MASTER, side, f"{side.state.name.lower()}: {side.reason.text}")

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
    granted = go_realtime()  # before the link: its threads are as urgent, and inherit it
    with ExitStack() as stack:
        # a master that is refused as the second one must not have touched the device
        link = stack.enter_context(Link(shared.link, shared.session, Role.MASTER))
        device = open_device(config.device)
        stack.callback(device.close)
        grid = Grid(shared.rate_hz, stop)
        master = Master(config, link, device, grid)
        run(master, grid, stop.request)
        summary = master.summary()
    summary |= {"stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    if not supervised():
        print("\n".join(loop_lines(summary)))
    if master.error:
        raise master.error
    return 0
