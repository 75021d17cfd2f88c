"""Convert rows of messages to Rerun columns in batches.

Entities, all on the timeline `time` (the stamp its sender gave a message):

======================================= ========================================================
scene/tendon_<i>/tube                   a sheath coloured by tension, and X' on it
scene/joint_<j>, scene/hand_<j>         tip and hand with the forces on them
scene/legend                            the colour scale
profile/tendon_<i>/curve, band          T(x) with X', and what is certain of it, as a plot
profile/tendon_<i>/tension              T(x) [N] itself: component `tension`, 65 numbers of 64 bits
loop/tendon_<i>/curve                   T_out over T_in
tension, displacement, elongation,      curves over time, see `teleop.view.curves`
force, position, hand, energy, rate,
latency, age, loss
state/<role>, log                       lanes of states, the text log
panel/banner, words, joint_<j>, link    state, force and link in large letters
======================================= ========================================================
"""

from collections.abc import Callable, Iterator, Mapping

import rerun as rr

from teleop.messages.topics import HAND, PROFILE, SHEATH, STATE, TENDONS, Role
from teleop.view.batch import AnyTopic, Rows, Subsampler, split_rows
from teleop.view.config import ViewConfig
from teleop.view.legend import draw_stage
from teleop.view.levers import Levers
from teleop.view.log import LOGGED_TOPICS, StateLanes, log_rows
from teleop.view.loop_view import LoopView
from teleop.view.panel import Panel
from teleop.view.plots import Plots
from teleop.view.profile_view import ProfileView
from teleop.view.sender import Sender
from teleop.view.sheaths import Sheaths
from teleop.view.tubes import Tubes


class Scene:
    """Draws decoded batches.

    Keeps only what later messages need: the sheaths, the newest interval at each tip, and static
    data.

    Parameters
    ----------
    config : ViewConfig
    stream : RecordingStream
    lay_out : callable
        Called with the tendons of each joint when they become known or change.
    everything : bool
        Also send what the layout does not show, for a file: it may be opened in another layout, or
        read by Rerun's tools.
    live : bool
        Grow the curves in tabs that are behind at first once a second; at the end less than a
        second of them is missing.
    """

    def __init__(
        self,
        config: ViewConfig,
        stream: rr.RecordingStream,
        lay_out: Callable[[Mapping[int, list[int]]], None] = lambda _: None,
        everything: bool = True,
        live: bool = False,
    ) -> None:
        self._config = config
        self._lay_out = lay_out
        self._everything = everything
        self._spatial = everything or config.layout != "surgeon"
        self._plotted = everything or config.layout == "experiment"
        self._sender = Sender(stream)
        self._sheaths = Sheaths(config)
        self._thinned = Subsampler()
        self._tubes = Tubes(config, self._sender, self._sheaths)
        self._levers = Levers(config, self._sender, self._sheaths, self._thinned)
        self._profiles = ProfileView(config, self._sender, self._sheaths, values=everything)
        self._loops = LoopView(config, self._sender)
        self._plots = Plots(config, self._sender, self._sheaths, self._thinned, live)
        self._lanes = StateLanes(self._sender)
        self._panel = Panel(config, self._sender, self._sheaths)

    @property
    def newest_ns(self) -> int:
        """The newest stamp that was sent [ns]; 0 before any."""
        return self._sender.newest_ns

    def send(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Send one batch of each topic, all of it; returns the number of rows that were shown."""
        return self.pictures(batches) + self.curves(batches)

    def pictures(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Update the scene and the log; returns the number of rows shown."""
        shown = 0
        if SHEATH in batches:
            shown += self._learn(batches[SHEATH])
        if self._plotted:
            shown += self._draw_plots(batches)
        if self._spatial:
            for tendon, rows in self._profile_rows(batches):
                self._tubes.draw(tendon, rows)
                shown += len(rows)
            self._levers.draw(batches)
        self._panel.draw(batches)
        return shown

    def curves(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw the curves over time and the loops, and send T(x); returns the number of rows shown.

        Both grow, so each block adds to what is there.
        """
        if not self._plotted:
            return 0
        if TENDONS in batches:
            self._loops.draw(self._thinned(batches[TENDONS], self._config.rate_hz.loop))
        for tendon, rows in self._profile_rows(batches) if self._everything else ():
            self._profiles.send_values(tendon, rows)
        return self._plots.draw(batches)

    def _draw_plots(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw T(x), the states and the log; returns the number of log lines."""
        shown = 0
        if TENDONS in batches:
            self._profiles.add(batches[TENDONS])
        for tendon, rows in self._profile_rows(batches):
            self._profiles.draw(tendon, rows)
        for role, topic in ((Role.MASTER, HAND), (Role.SLAVE, STATE)):
            if topic in batches:
                self._lanes.draw(role, batches[topic])
        for topic in LOGGED_TOPICS:
            if topic in batches:
                log_rows(self._sender, topic, batches[topic])
                shown += len(batches[topic])
        return shown

    def _profile_rows(self, batches: Mapping[AnyTopic, Rows]) -> Iterator[tuple[int, Rows]]:
        """Yield each tendon with its tension profiles, at the rate of the display."""
        for tendon, rows in (
            split_rows(batches[PROFILE], "tendon").items() if PROFILE in batches else ()
        ):
            yield tendon, self._thinned(rows, self._config.rate_hz.profile)

    def stretch(self, factor: float) -> None:
        """Draw fewer rows, by this factor, where the periods of drawing are stretched by it."""
        self._thinned.stretch = factor

    def silence(self, silent_ns: int) -> None:
        """Show that nothing has arrived for so long [ns]."""
        self._panel.silence(silent_ns)
        self._levers.forget_forces(self._panel.present_ns(silent_ns))

    def end(self, what: str, silent_ns: int = 0) -> None:
        """Show that a session or recording ended so long [ns] after its last data, no forces."""
        self._panel.end(what, silent_ns)
        self._levers.forget_forces(self._panel.present_ns(silent_ns))

    def show_panel(self) -> None:
        """Send all of the panel from now on, which `surgeon` shows; from any thread."""
        self._panel.whole = True

    def _learn(self, rows: Rows) -> int:
        """Process the sheaths, and redraw everything if they have changed."""
        if not self._sheaths.learn(rows):
            return 0
        self._sender.restyle()
        if self._spatial:
            self._place()
        joints = {joint: self._sheaths.tendons_of(joint) for joint in self._sheaths.joints}
        self._lay_out(joints)
        return len(joints)

    def _place(self) -> None:
        """Draw what stands still in the scene."""
        self._tubes.place()
        self._levers.place()
        if self._sheaths.stage is not None:
            draw_stage(self._sender, self._config, self._sheaths.stage)
