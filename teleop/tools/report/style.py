"""The style of figures, with the colours of Okabe and Ito, which any colour vision tells apart."""

from typing import Any

BLACK, BLUE, VERMILION, GREEN, GREY = "black", "#0072B2", "#D55E00", "#009E73", "#888888"

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.4,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 130,
}
