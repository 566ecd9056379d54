"""Figures: what they show, and that they say unit and frame."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import bell

import uwscan

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from uwscan import plot  # noqa: E402
from uwscan.plot import _calibration  # noqa: E402


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def labels(ax) -> str:
    ax.get_figure().canvas.draw()
    return " ".join(a.get_xlabel() + " " + a.get_ylabel() for a in ax.get_figure().axes)


def test_a_stripe_on_its_image():
    image = bell(slope=0.2)
    ax = plot.stripe(image, uwscan.extract_stripe(image))
    line = ax.lines[0]
    np.testing.assert_allclose(line.get_xdata(), 40.25 + 0.2 * np.arange(64), atol=0.05)
    assert "u, px" in labels(ax) and ax.yaxis_inverted()
    columns = plot.stripe(image.T, uwscan.extract_stripe(np.ascontiguousarray(image.T), axis="columns"))
    np.testing.assert_allclose(columns.lines[0].get_ydata(), 40.25 + 0.2 * np.arange(64), atol=0.05)
    with pytest.raises(uwscan.InputError):
        plot.stripe(image, uwscan.extract_stripe(image[None]))


def test_a_cloud_by_depth_sigma_intensity_and_numbers(cloud):
    for by in ["depth", "sigma", "intensity", np.arange(len(cloud))]:
        ax = plot.cloud(cloud, by=by, label="number")
        assert "camera frame" in labels(ax) and ax.yaxis_inverted()
        assert len(ax.collections[0].get_offsets()) == len(cloud)
    assert "z, mm" in labels(plot.cloud(cloud, view="xz"))
    with pytest.raises(uwscan.InputError, match="no sigma"):
        plot.cloud(uwscan.Cloud(cloud.points_mm), by="sigma")
    with pytest.raises(uwscan.InputError):
        plot.cloud(cloud, by="colour")
    with pytest.raises(uwscan.InputError):
        plot.cloud(cloud, by=np.arange(3))


def test_deviations_of_a_ball(cloud):
    fit = uwscan.fit_sphere(cloud)
    assert "distance from the sphere, mm" in labels(plot.deviations(cloud, fit))
    ax = plot.deviation_histogram(cloud, fit, limit_mm=1.0)
    assert sum(p.get_height() for p in ax.patches) == len(cloud)
    few = plot.deviation_histogram(cloud, fit, limit_mm=0.02)
    inside = int(sum(p.get_height() for p in few.patches))
    told = [t.get_text() for t in few.get_legend().get_texts()]
    assert f"{inside} points, {len(cloud) - inside} beyond" in told


def test_uncertainty_grows_with_depth(calibration):
    ax = plot.uncertainty(calibration, steps=30)
    sigma = np.asarray(ax.collections[0].get_array()).reshape(30, 30)
    middle = sigma[:, 15]
    assert np.all(np.diff(middle[np.isfinite(middle)]) > 0)
    scanner, index = calibration.scanner, calibration.water_index()
    # One of its points by the way of two pixels.
    z = np.linspace(500, 1100, 30)[15]
    pixel = [[np.linspace(0, 767, 30)[15], 288.0]]
    origin, direction = scanner.back_project(pixel, index=index)
    point = origin + (z - origin[:, 2:]) / direction[:, 2:] * direction
    voltage = _calibration._voltages(calibration, point, index)
    moved = scanner.triangulate(np.add(pixel, [[0.1, 0]]), voltage, index=index)
    assert np.linalg.norm(moved - point) == pytest.approx(middle[15], rel=1e-3)
