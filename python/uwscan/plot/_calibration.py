"""Figures of a calibration's uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from ._axes import axes, bar

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._uwscan import Calibration

#: Sine of the angle off the sheet below which a point is on it: 1e-9 mm on a metre.
_ON_SHEET = 1e-12


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
    ax = axes(ax)
    side = 0 if by_rows else 1
    drawn = ax.pcolormesh(points[..., side], points[..., 2], sigma, cmap="viridis", shading="gouraud", rasterized=True)
    bar(ax, drawn, f"standard deviation at {sigma_px:g} px, mm")
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
