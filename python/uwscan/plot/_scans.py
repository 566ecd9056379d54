"""Figures of stripes, clouds and shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, TwoSlopeNorm

from .. import errors
from .._uwscan import Cloud
from ._axes import BLUE, COVERED, DIVERGING, MOST_POINTS, ORANGE, axes, bar, pixels

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .._uwscan import CircleFit, CylinderFit, PlaneFit, SphereFit, Stripe

    Fit = SphereFit | PlaneFit | CylinderFit | CircleFit


def stripe(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    stripe: Stripe,
    *,
    ax: Axes | None = None,
    sigmas: float = 3.0,
    full_scale_dn: float | None = None,
) -> Axes:
    """The stripe on its image: each centre, and a band of ± `sigmas` standard deviations.

    Parameters
    ----------
    image : numpy.ndarray
        (h, w), the image that the stripe was extracted from.
    stripe : Stripe
        Of that image alone.
    ax : matplotlib.axes.Axes, optional
        Where to draw.
    sigmas : float, default 3
        Half-width of the band, standard deviations.
    full_scale_dn : float, optional
        Grey value that is drawn white; the image's largest by default.

    Returns
    -------
    matplotlib.axes.Axes
    """
    if image.ndim != 2 or stripe.position_px.ndim != 1:
        raise errors.InputError("plot.stripe draws one image (h, w) and its stripe: take one out of the stack")
    ax = axes(ax)
    drawn = ax.imshow(image, cmap="gray", vmin=0, vmax=full_scale_dn, interpolation="nearest")
    bar(ax, drawn, "grey value, DN")
    lines = np.arange(stripe.position_px.size)
    at, off = stripe.position_px, sigmas * stripe.sigma_px
    if stripe.axis == "rows":
        ax.plot(at, lines, color=ORANGE, lw=0.8, label="stripe's centre")
        ax.fill_betweenx(lines, at - off, at + off, color=ORANGE, alpha=0.35, lw=0, label=f"± {sigmas:g} σ")
    else:
        ax.plot(lines, at, color=ORANGE, lw=0.8, label="stripe's centre")
        ax.fill_between(lines, at - off, at + off, color=ORANGE, alpha=0.35, lw=0, label=f"± {sigmas:g} σ")
    pixels(ax, (image.shape[1], image.shape[0]))
    ax.legend(loc="upper right", framealpha=0.9)
    return ax


_AXES = {"x": 0, "y": 1, "z": 2}


def _scattered(ax: Axes, cloud: Cloud, values: NDArray[Any], view: str, norm: Normalize, cmap: str, label: str) -> Axes:
    a, b = (_AXES[letter] for letter in view)
    points = cloud.points_mm
    shown = slice(None, None, max(1, -(-len(points) // MOST_POINTS)))
    # What lies near is drawn last, as it is seen; extremes of what is coloured stay in sight.
    order = np.argsort(-points[shown, 2], kind="stable")
    extend: Literal["neither", "both", "min", "max"] = "neither"
    if len(values):
        low, high = bool(np.nanmin(values) < norm.vmin), bool(np.nanmax(values) > norm.vmax)
        extend = "both" if low and high else "min" if low else "max" if high else "neither"
    size = float(np.clip(2e4 / max(len(points), 1), 0.5, 6.0))
    drawn = ax.scatter(
        points[shown, a][order], points[shown, b][order], c=values[shown][order], s=size, lw=0, cmap=cmap, norm=norm,
        rasterized=True,
    )
    bar(ax, drawn, label, extend)
    ax.set(xlabel=f"{view[0]}, mm ({cloud.frame} frame)", ylabel=f"{view[1]}, mm")
    ax.set_aspect("equal")
    if view[1] == "y" and cloud.frame == "camera" and not ax.yaxis_inverted():
        ax.invert_yaxis()
    return ax


def cloud(
    cloud: Cloud,
    *,
    by: Literal["depth", "sigma", "intensity"] | NDArray[Any] = "depth",
    view: Literal["xy", "xz", "yz"] = "xy",
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A cloud as seen along an axis, coloured by depth, sigma, intensity, or numbers of your own.

    Parameters
    ----------
    cloud : Cloud
    by : str or numpy.ndarray, default "depth"
        "depth" (z), "sigma" (of the least certain direction, on a logarithmic scale), "intensity", or one number a point.
    view : str, default "xy"
        The two axes that are drawn: "xy" as the camera sees it (y down), "xz", "yz".
    label : str, optional
        What numbers of your own are, with their unit.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes
    """
    if isinstance(by, str):
        known: dict[str, tuple[Any, str]] = {
            "depth": (cloud.points_mm[:, 2], "z, mm"),
            "sigma": (cloud.sigma_mm, "standard deviation, mm"),
            "intensity": (cloud.intensity, "height of the stripe, DN"),
        }
        if by not in known:
            raise errors.InputError(f"by must be one of {', '.join(known)}, or an array, got {by!r}")
        values, name = known[by]
        if values is None:
            raise errors.InputError(f"the cloud has no {by}")
    else:
        values, name = np.asarray(by), label or ""
        if values.shape != (len(cloud),):
            raise errors.InputError(f"by must have the shape ({len(cloud)},), got {values.shape}")
    low, high = np.nanpercentile(values, COVERED) if len(values) else (0.0, 1.0)
    # Few points are alike to the last digit, but a plane's depths may be.
    low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
    norm = LogNorm(low, high) if isinstance(by, str) and by == "sigma" and low > 0 else Normalize(low, high)
    return _scattered(axes(ax), cloud, values, view, norm, "viridis", label or name)


def deviations(
    cloud: Cloud, fit: Fit, *, view: Literal["xy", "xz", "yz"] = "xy", limit_mm: float | None = None, ax: Axes | None = None
) -> Axes:
    """A cloud coloured by its points' distances from a fitted shape: red outside, blue inside.

    Parameters
    ----------
    cloud : Cloud
    fit : SphereFit, PlaneFit, CylinderFit or CircleFit
    view : str, default "xy"
        The two axes that are drawn.
    limit_mm : float, optional
        Distance of the last colours, mm; by default what 98 % of the points keep to.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes
    """
    off = fit.deviations_mm(cloud.points_mm)
    limit = limit_mm or float(np.percentile(np.abs(off), COVERED[1])) or 1.0
    norm = TwoSlopeNorm(0.0, -limit, limit)
    return _scattered(axes(ax), cloud, off, view, norm, DIVERGING, f"distance from the {fit.kind}, mm")


def deviation_histogram(
    points: Cloud | ArrayLike,
    fit: Fit,
    *,
    bins: int = 41,
    limit_mm: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """How many points lie how far from a fitted shape, with a normal distribution of the same spread.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm.
    fit : SphereFit, PlaneFit, CylinderFit or CircleFit
    bins : int, default 41
        Classes.
    limit_mm : float, optional
        Largest distance drawn, mm; by default four robust standard deviations. What lies beyond is counted in the legend.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes
    """
    at = points.points_mm if isinstance(points, Cloud) else points
    off = fit.deviations_mm(at)
    middle = float(np.median(off))
    # Of a normal distribution, the median distance from the median is 0.6745 sigmas.
    spread = float(np.median(np.abs(off - middle))) / 0.6745
    limit = limit_mm or 4 * spread or 1.0
    edges = np.linspace(-limit, limit, bins + 1)
    beyond = int(np.sum(np.abs(off) > limit))
    ax = axes(ax)
    ax.hist(off, edges.tolist(), color=BLUE, alpha=0.75, label=f"{off.size - beyond} points" + (f", {beyond} beyond" if beyond else ""))
    if spread > 0:
        x = np.linspace(-limit, limit, 400)
        bell = np.exp(-0.5 * ((x - middle) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        ax.plot(x, bell * off.size * (edges[1] - edges[0]), color=ORANGE, label=f"normal, σ = {spread:.3g} mm")
    ax.set(xlabel=f"distance from the {fit.kind}, mm (positive: outside)", ylabel="points in a class", xlim=(-limit, limit))
    # Room for the legend above what is drawn.
    ax.set_ylim(0, 1.25 * ax.get_ylim()[1])
    ax.legend(loc="upper right", framealpha=0.9)
    return ax
