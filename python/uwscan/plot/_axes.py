"""What all figures share: axes, colours, scales."""

from __future__ import annotations

from typing import Any, Literal

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
except ImportError as e:  # pragma: no cover
    raise ImportError("uwscan.plot needs matplotlib: pip install uwscan[plot]") from e

#: Okabe and Ito's blue and vermilion.
BLUE, ORANGE = "#0072B2", "#D55E00"
#: A blue-to-red scale that stays apart for colour-blind eyes.
DIVERGING = "RdBu_r"
#: Share of values that a colour scale covers; the rest shows in its last colour.
COVERED = (2.0, 98.0)
#: Points that a figure draws at most: more cannot be told apart.
MOST_POINTS = 200_000


def axes(ax: Axes | None, size: tuple[float, float] = (6.4, 4.8)) -> Axes:
    if ax is not None:
        return ax
    return plt.subplots(figsize=size, layout="constrained")[1]


def bar(ax: Axes, drawn: Any, label: str, extend: Literal["neither", "both", "min", "max"] = "neither") -> None:
    figure = ax.get_figure()
    if figure is not None:
        figure.colorbar(drawn, ax=ax, label=label, extend=extend)


def pixels(ax: Axes, size: tuple[int, int] | None) -> None:
    ax.set(xlabel="u, px", ylabel="v, px")
    ax.set_aspect("equal")
    if size is not None:
        ax.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5))
