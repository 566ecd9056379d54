"""Makes the figures of the pages in this folder: python docs/concepts/figures.py FOLDER. scripts/docs.sh calls it."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import uwscan  # noqa: E402
from uwscan.plot import BLUE, ORANGE  # noqa: E402

FIXTURES = Path(__file__).parents[2] / "fixtures"
GREEN, GREY, PURPLE = "#009E73", "0.45", "#CC79A7"


def save(figure: plt.Figure, folder: Path, name: str) -> None:
    figure.savefig(folder / f"{name}.svg", dpi=150)
    plt.close(figure)


def window(ax: plt.Axes, centre: np.ndarray, port: uwscan.Port, half: float, label: str | None) -> None:
    """The window's faces in the plane of x and z."""
    n = port.normal[[0, 2]] / np.hypot(*port.normal[[0, 2]])
    along = np.array([n[1], -n[0]])
    faces = [centre[[0, 2]] + n * (port.distance_mm + depth) for depth in (0, port.thickness_mm)]
    outline = np.array([faces[0] - half * along, faces[0] + half * along, faces[1] + half * along, faces[1] - half * along])
    ax.fill(*outline.T, color=BLUE, alpha=0.4, lw=0, label=label)


def frames(calibration: uwscan.Calibration, cloud: uwscan.Cloud, folder: Path) -> None:
    scanner, index = calibration.scanner, calibration.water_index()
    assert index is not None
    figure, ax = plt.subplots(figsize=(7, 5.6), layout="constrained")
    galvo = calibration.camera_from_galvo
    window(ax, np.zeros(3), scanner.camera_port, 60, "windows")
    window(ax, galvo[:3, 3], scanner.laser_port, 60, None)
    for origin, axes, name in [(np.zeros(3), np.eye(3), "camera"), (galvo[:3, 3], galvo[:3, :3], "galvanometer")]:
        for k, letter in ((0, "x"), (2, "z")):
            tip = origin + 110 * axes[:, k]
            if np.hypot(*(tip - origin)[[0, 2]]) > 20:
                ax.annotate("", tip[[0, 2]], origin[[0, 2]], arrowprops={"arrowstyle": "->", "color": "black"})
                ax.annotate(letter, tip[[0, 2]], xytext=(3, 3), textcoords="offset points")
        ax.plot(*origin[[0, 2]], "o", color="black", ms=4)
        ax.annotate(name, origin[[0, 2]], xytext=(0, -14), textcoords="offset points", ha="center")
    # The row that looks along y = 0, near enough.
    u = np.linspace(0, calibration.image_size[0] - 1, 400)
    row = np.stack([u, np.full_like(u, calibration.camera_matrix[1, 2])], axis=1)
    for k, voltage in enumerate(np.linspace(-1.0, 2.0, 5)):
        points = scanner.triangulate(row, voltage, index=index)
        seen = np.isfinite(points[:, 2]) & (points[:, 2] > 150) & (points[:, 2] < 1150)
        ax.plot(points[seen, 0], points[seen, 2], color=GREEN, lw=1, label="sheets of light" if k == 0 else None)
    ax.plot(cloud.points_mm[::5, 0], cloud.points_mm[::5, 2], ".", color=ORANGE, ms=1.5, label="points of a scan")
    ax.set(xlabel="x, mm (camera frame)", ylabel="z, mm", xlim=(-330, 600), ylim=(-110, 1160))
    ax.set_aspect("equal")
    ax.legend(loc="upper right", framealpha=0.9, markerscale=6)
    save(figure, folder, "frames")


def windows(folder: Path) -> None:
    port, index = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195), 1.335
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    left.axhspan(0, 10, color="white")
    left.axhspan(10, 18, color=BLUE, alpha=0.35, lw=0)
    left.axhspan(18, 60, color=BLUE, alpha=0.12, lw=0)
    for text, z in [("air", 5), ("glass", 14), ("water", 45)]:
        left.text(-38, z, text, va="center")
    for tangent in np.linspace(-0.8, 0.8, 9):
        [origin], [direction] = port.back_project([[tangent, 0, 1.0]], index=index)
        inner = np.array([10 * tangent, 10.0])
        far = origin + direction * (60 - origin[2]) / direction[2]
        left.plot([0, inner[0], origin[0], far[0]], [0, 10, origin[2], 60], color=ORANGE, lw=1.2)
    left.set(xlabel="x, mm", ylabel="z, mm", xlim=(-42, 42), ylim=(0, 60), title="rays through a window")
    left.set_aspect("equal")
    degrees = np.linspace(0.5, 40, 200)
    tangents = np.tan(np.radians(degrees))
    origins, directions = port.back_project(np.stack([tangents, 0 * tangents, 1 + 0 * tangents], axis=1), index=index)
    meets = origins[:, 2] - origins[:, 0] * directions[:, 2] / directions[:, 0]
    right.plot(degrees, meets, color=BLUE)
    right.axvline(np.degrees(np.arctan(384 / 1400)), color=GREY, ls="--", lw=1)
    right.text(np.degrees(np.arctan(384 / 1400)) + 0.7, meets.max(), "left and right border\nof the fixtures' images", color=GREY, va="top")
    right.set(xlabel="angle to the optical axis in air, degrees", ylabel="apparent origin: z, mm", xlim=(0, 40), title="where rays outside seem to come from")
    save(figure, folder, "windows")


def sheets(calibration: uwscan.Calibration, folder: Path) -> None:
    scanner, index = calibration.scanner, calibration.water_index()
    assert index is not None
    width, height = calibration.image_size
    v, u = np.linspace(0, height - 1, 60), np.linspace(0, width - 1, 200)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    points = scanner.triangulate(grid, 0.9, index=index).reshape(v.size, u.size, 3)
    plane = uwscan.fit_plane(points[np.isfinite(points).all(axis=2) & (points[..., 2] > 600) & (points[..., 2] < 1100)])
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for depth, colour, style in [(700, BLUE, "-"), (850, ORANGE, "--"), (1000, GREEN, "-.")]:
        along = np.array([[np.interp(depth, *_rising(row[:, 2], row[:, k])) for k in range(3)] for row in points])
        ax.plot(along[:, 1], plane.deviations_mm(along), color=colour, ls=style, label=f"{depth} mm away")
    ax.axhline(0, color=GREY, lw=0.8)
    ax.set(xlabel="along the line of light: y, mm (camera frame)", ylabel="distance from the plane, mm")
    ax.legend()
    save(figure, folder, "sheets")


def _rising(z: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(z)
    kept = order[np.isfinite(z[order])]
    return z[kept], value[kept]


def residuals(calibration: uwscan.Calibration, folder: Path) -> None:
    figure, ax = plt.subplots(figsize=(7, 4.8), layout="constrained")
    uwscan.plot.residual_vectors(calibration, ax=ax)
    save(figure, folder, "residual-vectors")
    figure, cells = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
    for ax, what, show in zip(cells.flat, ["corners", "corners", "stripes", "stripes"], ["rms", "mean"] * 2, strict=True):
        uwscan.plot.residual_map(calibration, what=what, show=show, cells=14, ax=ax)  # type: ignore[arg-type]
    save(figure, folder, "residual-maps")
    figure, pair = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    uwscan.plot.residual_histogram(calibration, what="corners", ax=pair[0])
    uwscan.plot.residual_histogram(calibration, what="stripes", ax=pair[1])
    save(figure, folder, "residual-histograms")


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    # Ids in SVG files are random otherwise.
    matplotlib.rcParams.update({"svg.hashsalt": "uwscan", "font.size": 10})
    calibration = uwscan.calibrate([FIXTURES / "cal-air", FIXTURES / "cal-water"], progress=False)
    cloud = uwscan.reconstruct(FIXTURES / "ball", calibration, progress=False)
    frames(calibration, cloud, folder)
    windows(folder)
    sheets(calibration, folder)
    figure, ax = plt.subplots(figsize=(7, 4.8), layout="constrained")
    uwscan.plot.uncertainty(calibration, ax=ax)
    save(figure, folder, "uncertainty")
    residuals(calibration, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
