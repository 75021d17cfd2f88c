"""How the views are laid out, for a screen of 1280 by 800 and up."""

import rerun as rr
import rerun.blueprint as rrb

from teleop.view.config import ViewConfig
from teleop.view.profile_plot import WIDTH
from teleop.view.scene import TIMELINE

_DARK = [18, 20, 24]


def default_blueprint(config: ViewConfig) -> rrb.Blueprint:
    """Return the default layout: the sheath and T(x) beside tensions, forces and the log.

    The time follows the newest data until the user takes hold of it.
    """
    recent = rr.VisibleTimeRange(
        TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-config.window_s),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
    plot = rrb.VisualBounds2D(x_range=[-0.25, WIDTH + 0.15], y_range=[-1.2, 0.32])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin="sheath",
                    name=f"Tension along the sheath (0 to {config.tension_scale_N:g} N)",
                    background=_DARK,
                    line_grid=False,
                ),
                rrb.Spatial2DView(
                    origin="profile", name="T(x)", visual_bounds=plot, background=_DARK
                ),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="tension", name="Tension [N]", time_ranges=[recent]),
                rrb.TimeSeriesView(
                    origin="force",
                    name="Force on the hand and at the tip [N]",
                    time_ranges=[recent],
                ),
                rrb.Tabs(
                    rrb.TextLogView(
                        origin="events",
                        name="Events",
                        columns=rrb.TextLogColumns(
                            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
                        ),
                    ),
                    rrb.TimeSeriesView(
                        origin="position", name="Position [m]", time_ranges=[recent]
                    ),
                    rrb.TimeSeriesView(
                        origin="displacement", name="Displacement [m]", time_ranges=[recent]
                    ),
                    rrb.TimeSeriesView(origin="front", name="Front X' [m]", time_ranges=[recent]),
                    rrb.TimeSeriesView(origin="loop", name="Loops", time_ranges=[recent]),
                ),
                row_shares=[3, 3, 2],
            ),
            column_shares=[1, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
    )
