"""Layouts of the views, for screens of 1280 by 800 and up: one blueprint per use."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Literal

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn

from teleop.view.colours import BACKGROUND, UNKNOWN
from teleop.view.columns import TIMELINE
from teleop.view.config import ViewConfig
from teleop.view.panel_layout import BANNER, PANEL_HEIGHT, PANEL_WIDTH
from teleop.view.profile_plot import WIDTH
from teleop.view.scene_geometry import EYE

_DARK = list(BACKGROUND)
_LEGEND_SHARE = 0.32  # of the window, right of the newest data, for the legend
_FEW_JOINTS = 4  # joints
_MOTOR = ("displacement/tendon_{tendon}/in", "displacement/tendon_{tendon}/asked")
_UNKNOWN_M = 0.001  # [m] radius of a tube before its tension is known
Part = rrb.Container | rrb.View
_Make = Callable[[str, int], Part]  # name of a view, and the joint it is of


def build_blueprint(
    config: ViewConfig, joints: Mapping[int, Sequence[int]], arms: int = 0
) -> rrb.Blueprint:
    """Return the layout that the config names.

    `surgeon` shows state, force and link in large letters and nothing else, `experiment`
    everything, `presentation` the scene alone. The time follows the newest data until the user
    moves it.

    `joints` has the tendons of each, and is empty while they are not known.
    """
    views = _Views(config, dict(joints) or {0: [0, 1]}, arms)
    arrange: dict[str, Callable[[], Part]] = {
        "surgeon": views.build_panel,
        "experiment": partial(_arrange_experiment, views),
        "presentation": partial(views.build_scene, distance=0.88),
    }
    bars: Literal["collapsed", "hidden"]
    bars = "collapsed" if config.layout == "experiment" else "hidden"  # the clock in it moves
    return rrb.Blueprint(
        arrange[config.layout](),
        rrb.TopPanel(state="hidden"),
        rrb.BlueprintPanel(state=bars),
        rrb.SelectionPanel(state=bars),
        rrb.TimePanel(state=bars, timeline=TIMELINE, play_state="following"),
        auto_views=False,
    )


def _arrange_experiment(views: "_Views") -> Part:
    tension = views.build_trace("tension/tendon_{tendon}", values=(-0.05, 1.1))
    return rrb.Horizontal(
        rrb.Vertical(
            views.build_banner(),
            views.build_scene(distance=0.9),
            rrb.Horizontal(
                views.build_joint_tabs("T(x) in its band", views.build_profile, short="T(x)"),
                views.build_joint_tabs("T_out over T_in", views.build_loop, short="Loop"),
            ),
            row_shares=[0.7, 3, 2.3],
        ),
        rrb.Vertical(
            views.build_joint_tabs(
                "Tension [N]", tension, " at the housing (measured) and at the tip"
            ),
            views.build_forces(),
            rrb.Tabs(
                views.build_joint_tabs("Tip [mm]", views.build_position, ", positive pulled in"),
                views.build_joint_tabs("Hand [N]", views.build_trace("hand/joint_{joint}")),
                views.build_joint_tabs(
                    "Elongation [mm]", views.build_trace("elongation/tendon_{tendon}")
                ),
                views.build_joint_tabs("Motor [mm]", views.build_trace(*_MOTOR)),
                views.build_joint_tabs("K", views.build_trace("friction/tendon_{tendon}")),
                name="Motion",
            ),
            rrb.Tabs(
                views.build_log(),
                views.build_states(),
                views.build_curves("Energy [mJ]", ["energy"]),
                views.build_curves("Rate [Hz]", ["rate"]),
                rrb.Tabs(  # one in the other: all tabs have room in 640 pixels
                    views.build_curves("Latency [ms]", ["latency"]),
                    views.build_curves("Budget [ms]", ["budget"]),
                    views.build_curves("Age [ms]", ["age"]),
                    name="Delays [ms]",
                ),
                views.build_curves("Lost", ["loss"]),
                name="Session",
            ),
            row_shares=[4.4, 3.6, 3.4, 2.6],
        ),
        column_shares=[1, 1],
    )


class _Views:
    """The views to choose from."""

    def __init__(self, config: ViewConfig, joints: dict[int, Sequence[int]], arms: int) -> None:
        self._config = config
        self._joints = joints
        self._arms = arms
        self._recent = _build_past_range(config.window_s)

    def build_scene(self, distance: float = 1.0) -> Part:
        """Return the scene, seen from above its near side; a narrow view needs more `distance`."""
        return rrb.Spatial3DView(
            origin="/",
            contents=["/scene/**"],
            name="Tension along the sheath   thick: slides, thin: sticks, red: X'",
            background=_DARK,
            line_grid=False,
            defaults=[rr.Capsules3D.from_fields(radii=_UNKNOWN_M, colors=UNKNOWN)],
            eye_controls=rrb.EyeControls3D(
                position=[distance * part for part in EYE], look_target=(0, 0, 0), eye_up=(0, 0, 1)
            ),
        )

    def build_panel(self) -> Part:
        """Return state, force and link in large letters."""
        return self._build_letters("/panel/**", PANEL_HEIGHT)

    def build_banner(self) -> Part:
        """Return the state in large letters."""
        return self._build_letters("/panel/banner/**", BANNER[3])

    def _build_letters(self, contents: str, tall: float) -> Part:
        return rrb.Spatial2DView(
            origin="panel",
            contents=[contents],
            name="State",
            titlebar=False,
            visual_bounds=rrb.VisualBounds2D(x_range=[0.0, PANEL_WIDTH], y_range=[0.0, tall]),
            background=_DARK,
        )

    def build_joint_tabs(self, name: str, make: _Make, detail: str = "", short: str = "") -> Part:
        """Return one view for each joint, one in front of the other.

        The first tab says what they all show, the others have but the number of their joint, so
        that the tabs have room on a screen of 1280 pixels. A `short` name is used for several
        joints in a narrow view, `detail` is left out for many.
        """
        if len(self._joints) == 1:
            return make(name + detail, *self._joints)
        if len(self._joints) > _FEW_JOINTS:
            detail = ""
        first = min(self._joints)
        whole = f"{short} {first + 1}" if short else f"{name}{detail}, joint {first + 1}"
        tabs = (make(whole if j == first else f"{j + 1}", j) for j in self._joints)
        return rrb.Tabs(*tabs, name=name + detail)

    def build_profile(self, name: str, joint: int) -> Part:
        """Return T(x) of a joint's tendons."""
        return self._build_plane("profile", name, joint, [-0.25, WIDTH + 0.15])

    def build_loop(self, name: str, joint: int) -> Part:
        """Return the hysteresis loops of a joint's tendons, as far back as the config says."""
        past = _build_past_range(self._config.loop_window_s)
        return self._build_plane("loop", name, joint, [-0.2, 1.85], [past])

    def _build_plane(
        self,
        root: str,
        name: str,
        joint: int,
        x_range: list[float],
        past: list[rr.VisibleTimeRange] | None = None,
    ) -> Part:
        frame = ("axes", "labels", "scale", "names")
        own = [f"tendon_{tendon}/**" for tendon in self._joints[joint]]
        return rrb.Spatial2DView(
            origin=root,
            contents=[f"/{root}/{part}" for part in (*frame, *own)],
            name=name,
            visual_bounds=rrb.VisualBounds2D(x_range=x_range, y_range=[-1.2, 0.32]),
            background=_DARK,
            time_ranges=past,
        )

    def build_trace(self, *paths: str, values: tuple[float, float] | None = None) -> _Make:
        """Return what makes a view of some entities of a joint, or of each of its tendons."""

        def make(name: str, joint: int) -> Part:
            tendons = self._joints[joint]
            roots = [path.format(joint=joint, tendon=t) for t in tendons for path in paths]
            return self.build_curves(name, list(dict.fromkeys(roots)), values)

        return make

    def build_tip_force(self, name: str, joint: int) -> Part:
        """Return the estimate of the force at the tip with its interval, and the truth."""
        pulls_one_way = len(self._joints[joint]) == 1
        return self.build_curves(
            name, [f"force/joint_{joint}"], (-0.05 if pulls_one_way else -1.1, 1.1)
        )

    def build_forces(self) -> Part:
        """Return the force at each joint, behind those at the tips of arms in space."""
        if self._arms == 0:
            return self.build_joint_tabs(
                "Force at the tip [N]", self.build_tip_force, ", positive against pulling"
            )
        tips = (
            self.build_curves(
                f"Force at the tip of arm {arm + 1} [N], in its base" if arm == 0 else f"{arm + 1}",
                [f"tip_force/arm_{arm}"],
            )
            for arm in range(self._arms)
        )
        return rrb.Tabs(
            *tips,
            self.build_joint_tabs("Joints [N]", self.build_tip_force),
            name="Force at the tip [N]",
        )

    def build_position(self, name: str, joint: int) -> Part:
        """Return the commanded, estimated and true position of the tip."""
        truth = f"displacement/tendon_{self._joints[joint][0]}/out_true"
        return self.build_curves(name, [f"position/joint_{joint}", truth])

    def build_curves(
        self, name: str, roots: Sequence[str], values: tuple[float, float] | None = None
    ) -> Part:
        """Return a time series view of some entities over the recent past.

        `values` are the ends of the axis as shares of the scale of tension; without them the axis
        follows the data.
        """
        top = self._config.tension_scale_N
        return rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{root}/**" for root in roots],
            name=name,
            time_ranges=[self._recent],
            # the legend stands right of the newest data
            axis_x=rrb.TimeAxis(
                view_range=_build_time_range(
                    self._config.window_s, _LEGEND_SHARE * self._config.window_s
                )
            ),
            axis_y=values and rrb.ScalarAxis(range=(values[0] * top, values[1] * top)),
            plot_legend=rrb.Corner2D.RightTop,
        )

    def build_states(self) -> Part:
        """Return the states of both sides as lanes."""
        return rrb.StateTimelineView(origin="state", name="State", time_ranges=[self._recent])

    def build_log(self) -> Part:
        """Return the log of events."""
        return rrb.TextLogView(
            origin="log",
            name="Log",
            # Rerun draws a column of times too narrow to be read; the text begins with it
            columns=rrb.TextLogColumns(
                timeline_columns=[TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["loglevel", "body"],
            ),
        )


def _build_past_range(seconds: float) -> rr.VisibleTimeRange:
    """Return the time range from some seconds ago until now."""
    range_ = _build_time_range(seconds, 0.0)
    return rr.VisibleTimeRange(TIMELINE, start=range_.start, end=range_.end)


def _build_time_range(past_s: float, future_s: float) -> rr.TimeRange:
    """Return the time range about the cursor."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-past_s),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=future_s),
    )
