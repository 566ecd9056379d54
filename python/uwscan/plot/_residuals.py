"""Figures of what remained of a calibration's measurements: where statistics hide what is systematic."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, TwoSlopeNorm

from .. import errors
from ._axes import BLUE, COVERED, DIVERGING, ORANGE, axes, bar, pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._uwscan import Calibration, Residuals, ResidualTable

#: Arrows that a figure draws at most: more hide each other.
_MOST_ARROWS = 4000
#: Cells across an image at most.
_MOST_CELLS = 1000
#: Fewest measurements that a cell's figure is drawn from.
_FEWEST = 3
#: Length of the longest arrows but a few, as a share of the image's width.
_LONG = 0.08


def residual_vectors(
    calibration: Calibration,
    *,
    medium: Literal["air", "water"] | None = None,
    magnified: float | None = None,
    outliers: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """The corners' residuals as arrows on the image, from where each corner was seen towards where the model puts it.

    Parameters
    ----------
    calibration : Calibration
        Made by `uwscan.calibrate` in this program: a file does not hold residuals.
    medium : str, optional
        "air" or "water": only the placements there.
    magnified : float, optional
        How many times longer arrows are drawn than they are; by default so that 98 % of them are shorter than a twelfth of the image.
    outliers : bool, default False
        Draw those, too, that were sorted out.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        For a calibration without residuals, or without any in this medium.
    """
    remains = _remains(calibration)
    table = remains.corners
    shown = _shown(remains, table, medium, outliers)
    at, off = table.pixel[shown], table.residual_px[shown]
    thinned = slice(None, None, max(1, -(-len(at) // _MOST_ARROWS)))
    at, off = at[thinned], off[thinned]
    size = np.linalg.norm(off, axis=1)
    long = float(np.percentile(size, COVERED[1])) or 1.0
    width, _ = calibration.image_size
    times = magnified or _round_down(_LONG * width / long)
    ax = axes(ax)
    drawn = ax.quiver(
        *at.T, *off.T, size, angles="xy", scale_units="xy", scale=1 / times, cmap="viridis", norm=Normalize(0, long), width=0.003
    )
    bar(ax, drawn, "residual, px", "max" if size.max() > long else "neither")
    pixels(ax, calibration.image_size)
    ax.set_title(f"{len(at)} corners{_where(medium)}, arrows {times:g} times their length, {_rms(off):.3f} px rms", fontsize="medium")
    return ax


def residual_map(
    calibration: Calibration,
    *,
    what: Literal["corners", "stripes"] = "corners",
    show: Literal["rms", "mean"] = "rms",
    medium: Literal["air", "water"] | None = None,
    cells: int = 16,
    ax: Axes | None = None,
) -> Axes:
    """Residuals over the image, cell by cell: noise has the same root mean square everywhere and means near zero; what bends has not.

    Parameters
    ----------
    calibration : Calibration
        Made by `uwscan.calibrate` in this program: a file does not hold residuals.
    what : str, default "corners"
        "corners", or "stripes": along the measured coordinate.
    show : str, default "rms"
        "rms", or "mean": of stripes the signed mean in colours, of corners its length in colours and an arrow along it.
    medium : str, optional
        "air" or "water": only the placements there.
    cells : int, default 16
        Cells across the image; as many down it as make them square.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        For a calibration without residuals, without any in this medium, or a setting that can't be.
    """
    remains = _remains(calibration)
    if what not in ("corners", "stripes") or show not in ("rms", "mean"):
        raise errors.InputError(f'what must be "corners" or "stripes", show "rms" or "mean", got {what!r} and {show!r}')
    if not 1 <= cells <= _MOST_CELLS:
        raise errors.InputError(f"cells must be from 1 to {_MOST_CELLS}, got {cells}")
    table = remains.corners if what == "corners" else remains.stripes
    shown = _shown(remains, table, medium, outliers=False)
    at, off = table.pixel[shown], table.residual_px[shown]
    off = off.reshape(len(off), -1)
    width, height = calibration.image_size
    down = max(1, round(cells * height / width))
    u, v = np.linspace(-0.5, width - 0.5, cells + 1), np.linspace(-0.5, height - 0.5, down + 1)
    place = np.clip(np.searchsorted(v, at[:, 1]) - 1, 0, down - 1) * cells + np.clip(np.searchsorted(u, at[:, 0]) - 1, 0, cells - 1)
    count = np.bincount(place, minlength=cells * down)
    known = count >= _FEWEST
    sums = np.stack([np.bincount(place, column, cells * down) for column in off.T], axis=1)
    squares = np.bincount(place, np.sum(off**2, axis=1), cells * down)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known[:, None], sums / count[:, None], np.nan)
        value = np.sqrt(np.where(known, squares / count, np.nan)) if show == "rms" else _length(mean)
    if not known.any():
        raise errors.InputError(f"no cell holds {_FEWEST} {what}: take fewer cells")
    ax = axes(ax)
    signed = show == "mean" and what == "stripes"
    top = float(np.nanpercentile(np.abs(value), COVERED[1])) or 1.0
    norm: Normalize = TwoSlopeNorm(0.0, -top, top) if signed else Normalize(0.0, top)
    drawn = ax.pcolormesh(u, v, value.reshape(down, cells), cmap=DIVERGING if signed else "viridis", norm=norm)
    along = "u" if calibration.axis == "rows" else "v"
    named = f"mean residual along {along}, px" if signed else "length of the mean residual, px" if show == "mean" else "residual, px rms"
    high, low = bool(np.nanmax(value) > top), bool(signed and np.nanmin(value) < -top)
    bar(ax, drawn, named, "both" if high and low else "max" if high else "min" if low else "neither")
    if show == "mean" and what == "corners":
        middle = np.stack(np.meshgrid((u[1:] + u[:-1]) / 2, (v[1:] + v[:-1]) / 2), axis=-1).reshape(-1, 2)
        # The longest arrow but a few is as long as a cell is wide.
        scale = top / (u[1] - u[0])
        for colour, wide in (("black", 0.009), ("white", 0.0045)):
            ax.quiver(
                *middle[known].T, *mean[known].T, angles="xy", scale_units="xy", scale=scale, color=colour, width=wide, pivot="mid", zorder=3
            )
    ax.set_facecolor("0.85")
    pixels(ax, calibration.image_size)
    ax.set_title(f"{len(at)} {what if what == 'corners' else 'stripe points'}{_where(medium)}; grey: fewer than {_FEWEST}", fontsize="medium")
    return ax


def residual_histogram(
    calibration: Calibration,
    *,
    what: Literal["corners", "stripes"] = "corners",
    medium: Literal["air", "water"] | None = None,
    bins: int = 61,
    ax: Axes | None = None,
) -> Axes:
    """Residuals in standard deviations, as measurements were weighted, beside the normal distribution that they are taken for.

    Parameters
    ----------
    calibration : Calibration
        Made by `uwscan.calibrate` in this program: a file does not hold residuals.
    what : str, default "corners"
        "corners" (both coordinates of each) or "stripes".
    medium : str, optional
        "air" or "water": only the placements there.
    bins : int, default 61
        Classes from -5 to 5.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        For a calibration without residuals, or without any in this medium.
    """
    remains = _remains(calibration)
    if what not in ("corners", "stripes"):
        raise errors.InputError(f'what must be "corners" or "stripes", got {what!r}')
    table = remains.corners if what == "corners" else remains.stripes
    off = table.standardised[_shown(remains, table, medium, outliers=False)].ravel()
    edges = np.linspace(-5, 5, bins + 1)
    beyond = int(np.sum(np.abs(off) > 5))
    ax = axes(ax)
    named = f"{off.size} residuals, σ = {np.std(off):.2f}" + (f", {beyond} beyond" if beyond else "")
    ax.hist(off, edges.tolist(), color=BLUE, alpha=0.75, label=named)
    x = np.linspace(-5, 5, 400)
    ax.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi) * off.size * (edges[1] - edges[0]), color=ORANGE, label="normal, σ = 1")
    ax.set(xlabel=f"residual of {what}, standard deviations{_where(medium)}", ylabel="residuals in a class", xlim=(-5, 5))
    ax.set_ylim(0, 1.25 * ax.get_ylim()[1])
    ax.legend(loc="upper right", framealpha=0.9)
    return ax


def _remains(calibration: Calibration) -> Residuals:
    remains = calibration.residuals
    if remains is None:
        raise errors.InputError(
            "this calibration has no residuals: files do not hold them, and the paper's method tells none; calibrate anew with uwscan.calibrate"
        )
    return remains


def _shown(remains: Residuals, table: ResidualTable, medium: str | None, outliers: bool) -> NDArray[np.bool_]:
    if medium not in (None, "air", "water"):
        raise errors.InputError(f'medium must be "air", "water" or None, got {medium!r}')
    shown = np.ones(len(table), dtype=np.bool_) if outliers else table.used.copy()
    if medium is not None:
        shown &= np.array([m == medium for m in remains.pose_medium])[table.pose]
    if not shown.any():
        raise errors.InputError(f"no residual is left to draw{_where(medium)}")
    return shown


def _where(medium: str | None) -> str:
    return f" in {medium}" if medium else ""


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of one column its value, of two their length."""
    return vectors[:, 0] if vectors.shape[1] == 1 else np.linalg.norm(vectors, axis=1)


def _rms(vectors: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def _round_down(value: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1, 2, 5) if k * power <= value * (1 + 1e-9)))
