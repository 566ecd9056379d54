"""Figures with matplotlib (``pip install uwscan[plot]``).

Every function draws into the axes that it is given, or into a new figure, and returns the axes. Axes are labelled with unit and frame; colours
are those that colour-blind readers tell apart (viridis, a blue-to-red scale with a light middle, Okabe and Ito's palette).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from . import errors

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.colors import LogNorm, Normalize, TwoSlopeNorm
except ImportError as e:  # pragma: no cover
    raise ImportError("uwscan.plot needs matplotlib: pip install uwscan[plot]") from e

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._uwscan import Calibration, CircleFit, Cloud, CylinderFit, PlaneFit, SphereFit, Stripe

    Fit = SphereFit | PlaneFit | CylinderFit | CircleFit

__all__ = [
    "BLUE",
    "ORANGE",
    "cloud",
    "deviation_histogram",
    "deviations",
    "stripe",
    "uncertainty",
]

#: Okabe and Ito's blue and vermilion.
BLUE, ORANGE = "#0072B2", "#D55E00"
#: A blue-to-red scale that stays apart for colour-blind eyes.
DIVERGING = "RdBu_r"
#: Share of values that a colour scale covers; the rest shows in its last colour.
COVERED = (2.0, 98.0)
#: Points that a figure draws at most: more cannot be told apart.
MOST_POINTS = 200_000
#: Sine of the angle off the sheet below which a point is on it: 1e-9 mm on a metre.
_ON_SHEET = 1e-12


def _axes(ax: Axes | None, size: tuple[float, float] = (6.4, 4.8)) -> Axes:
    if ax is not None:
        return ax
    return cast(Axes, plt.subplots(figsize=size, layout="constrained")[1])


def _bar(ax: Axes, drawn: Any, label: str, extend: Literal["neither", "both", "min", "max"] = "neither") -> None:
    figure = ax.get_figure()
    if figure is not None:
        figure.colorbar(drawn, ax=ax, label=label, extend=extend)


def _pixels(ax: Axes, size: tuple[int, int] | None) -> None:
    ax.set(xlabel="u, px", ylabel="v, px")
    ax.set_aspect("equal")
    if size is not None:
        ax.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5))


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
    ax = _axes(ax)
    drawn = ax.imshow(image, cmap="gray", vmin=0, vmax=full_scale_dn, interpolation="nearest")
    _bar(ax, drawn, "grey value, DN")
    lines = np.arange(stripe.position_px.size)
    at, off = stripe.position_px, sigmas * stripe.sigma_px
    if stripe.axis == "rows":
        ax.plot(at, lines, color=ORANGE, lw=0.8, label="stripe's centre")
        ax.fill_betweenx(lines, at - off, at + off, color=ORANGE, alpha=0.35, lw=0, label=f"± {sigmas:g} σ")
    else:
        ax.plot(lines, at, color=ORANGE, lw=0.8, label="stripe's centre")
        ax.fill_between(lines, at - off, at + off, color=ORANGE, alpha=0.35, lw=0, label=f"± {sigmas:g} σ")
    _pixels(ax, (image.shape[1], image.shape[0]))
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
    _bar(ax, drawn, label, extend)
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
    return _scattered(_axes(ax), cloud, values, view, norm, "viridis", label or name)


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
    return _scattered(_axes(ax), cloud, off, view, norm, DIVERGING, f"distance from the {fit.kind}, mm")


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
    at: Any = points.points_mm if hasattr(points, "points_mm") else points
    off = fit.deviations_mm(at)
    middle = float(np.median(off))
    # Of a normal distribution, the median distance from the median is 0.6745 sigmas.
    spread = float(np.median(np.abs(off - middle))) / 0.6745
    limit = limit_mm or 4 * spread or 1.0
    edges = np.linspace(-limit, limit, bins + 1)
    beyond = int(np.sum(np.abs(off) > limit))
    ax = _axes(ax)
    ax.hist(off, edges, color=BLUE, alpha=0.75, label=f"{off.size - beyond} points" + (f", {beyond} beyond" if beyond else ""))
    if spread > 0:
        x = np.linspace(-limit, limit, 400)
        bell = np.exp(-0.5 * ((x - middle) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        ax.plot(x, bell * off.size * (edges[1] - edges[0]), color=ORANGE, label=f"normal, σ = {spread:.3g} mm")
    ax.set(xlabel=f"distance from the {fit.kind}, mm (positive: outside)", ylabel="points in a class", xlim=(-limit, limit))
    # Room for the legend above what is drawn.
    ax.set_ylim(0, 1.25 * ax.get_ylim()[1])
    ax.legend(loc="upper right", framealpha=0.9)
    return ax


def uncertainty(
    calibration: Calibration,
    *,
    index: float | None = None,
    depths_mm: tuple[float, float] = (500.0, 1100.0),
    sigma_px: float = 0.1,
    line: float | None = None,
    steps: int = 80,
    ax: Axes | None = None,
) -> Axes:
    """Standard deviation that a stripe's error of `sigma_px` makes of a point, over a section of the working volume.

    The section holds the points that one line of the image (its middle by default) sees; each is where the sheet of light crosses the
    line of sight. What the calibration's own error adds is common to all points, and not drawn.

    Parameters
    ----------
    calibration : Calibration
    index : float, optional
        Index of refraction outside; the calibration's water by default, air for one without.
    depths_mm : tuple of float
        Nearest and farthest depth, camera frame, mm.
    sigma_px : float, default 0.1
        Standard deviation of a stripe's position, px.
    line : float, optional
        Row (or column, for stripes along rows) of the image.
    steps : int, default 80
        Points along and across.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes
    """
    scanner, (width, height) = calibration.scanner, calibration.image_size
    if index is None:
        index = calibration.water_index() or 1.0
    by_rows = calibration.axis == "rows"
    across = np.linspace(0, (width if by_rows else height) - 1, steps)
    at = np.full(steps, (line if line is not None else (height if by_rows else width) / 2))
    pixels = np.stack([across, at] if by_rows else [at, across], axis=1)
    origins, directions = scanner.back_project(pixels, index=index)
    z = np.linspace(*depths_mm, steps)
    reach = (z[:, None] - origins[None, :, 2]) / directions[None, :, 2]
    points = origins + reach[..., None] * directions
    flat = points.reshape(-1, 3)
    voltages = _voltages(calibration, flat, index)
    seen = np.tile(pixels, (steps, 1))
    _, per_u, per_v, _ = scanner.triangulate_with_derivatives(seen, voltages, index=index)
    sigma = sigma_px * np.linalg.norm(per_u if by_rows else per_v, axis=1).reshape(steps, steps)
    ax = _axes(ax)
    side = 0 if by_rows else 1
    drawn = ax.pcolormesh(points[..., side], points[..., 2], sigma, cmap="viridis", shading="gouraud", rasterized=True)
    _bar(ax, drawn, f"standard deviation at {sigma_px:g} px, mm")
    lines = ax.contour(points[..., side], points[..., 2], sigma, colors="white", linewidths=0.8)
    ax.clabel(lines, fmt="%.2g")
    ax.set(xlabel=f"{'xy'[side]}, mm (camera frame)", ylabel="z, mm")
    ax.set_aspect("equal")
    return ax


def _voltages(calibration: Calibration, points: NDArray[np.float64], index: float) -> NDArray[np.float64]:
    """The voltages whose sheets pass through points, by the secant's steps; NaN where they do not settle."""
    scanner = calibration.scanner
    before = np.full(len(points), scanner.galvo.reference_v)
    at = before + 0.1
    off_before, off = (scanner.off_sheet(points, v, index=index) for v in (before, at))
    for _ in range(50):
        with np.errstate(invalid="ignore", divide="ignore"):
            step = -off * (at - before) / (off - off_before)
        # Where rounding is all that is left, the secant points anywhere.
        step = np.where(np.abs(off) < _ON_SHEET, 0.0, np.clip(step, -1.0, 1.0))
        before, off_before = at, off
        at = at + step
        off = scanner.off_sheet(points, at, index=index)
        if not np.nanmax(np.abs(step), initial=0.0) > 1e-12:
            break
    return np.where(np.abs(off) < _ON_SHEET, at, np.nan)
