"""Residuals of a calibration, and their figures."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import FIXTURES

import uwscan

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from uwscan import plot  # noqa: E402


@pytest.fixture(scope="module")
def made() -> uwscan.Calibration:
    return uwscan.calibrate([FIXTURES / "cal-air", FIXTURES / "cal-water"])


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def test_residuals_are_those_of_the_statistics(made, tmp_path):
    remains, statistics = made.residuals, made.statistics
    corners, stripes = remains.corners, remains.stripes
    assert corners.used.sum() == statistics["corners"] and stripes.used.sum() == statistics["stripe_points"]
    kept = corners.residual_px[corners.used]
    np.testing.assert_allclose(np.sqrt(np.mean(np.sum(kept**2, axis=1))), statistics["reprojection_rms_px"], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.mean(stripes.residual_px[stripes.used] ** 2)), statistics["stripe_rms_px"], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.mean(stripes.off_sheet_mm[stripes.used] ** 2)), statistics["stripe_rms_mm"], rtol=1e-9)
    # The common scale is that of the median, and flanks are wider than a normal distribution's.
    for table in (corners, stripes):
        assert np.std(table.standardised[table.used]) == pytest.approx(1, abs=0.3)
    assert np.median(np.sum(corners.standardised[corners.used] ** 2, axis=1)) == pytest.approx(1.386, rel=0.1), "chi-square's median"
    again = tmp_path / "calibration.toml"
    made.save(again)
    assert uwscan.Calibration.load(again).residuals is None


def test_each_residual_says_where_it_is_from(made):
    remains = made.residuals
    assert len(remains.pose_medium) == len(remains.camera_from_board) and {"air", "water"} == set(remains.pose_medium)
    for table, each in [(remains.corners, (2,)), (remains.stripes, ())]:
        n = len(table)
        assert table.residual_px.shape == table.standardised.shape == (n, *each)
        assert table.pose.shape == table.frame.shape == table.point.shape == table.used.shape == (n,)
        assert table.pose.max() < len(remains.pose_medium) and table.frame.max() < len(remains.files)
        width, height = made.image_size
        assert (table.pixel >= -0.5).all() and (table.pixel < [width - 0.5, height - 0.5]).all()
    assert remains.corners.voltage_v is None and remains.corners.off_sheet_mm is None
    stripes = remains.stripes
    np.testing.assert_array_equal(stripes.point, stripes.pixel[:, 1])
    frames = {f"{c}/{f.file}": f for c in ("cal-air", "cal-water") for f in uwscan.open_capture(FIXTURES / c)}
    for k in np.linspace(0, len(stripes) - 1, 20).astype(int):
        capture, folder, file = remains.files[stripes.frame[k]].split("/")[-3:]
        frame = frames[f"{capture}/{folder}/{file}"]
        assert frame.voltage_v == stripes.voltage_v[k]
        assert remains.pose_medium[stripes.pose[k]] == ("air" if capture == "cal-air" else "water")


def test_figures_show_them_with_units(made, calibration_file):
    vectors = plot.residual_vectors(made, medium="water")
    arrows = vectors.collections[0]
    water = np.array([m == "water" for m in made.residuals.pose_medium])[made.residuals.corners.pose] & made.residuals.corners.used
    assert arrows.N == water.sum() and "u, px" in vectors.get_xlabel()
    assert plot.residual_vectors(made, outliers=True, magnified=50.0).collections[0].N >= arrows.N
    for what in ("corners", "stripes"):
        for show in ("rms", "mean"):
            ax = plot.residual_map(made, what=what, show=show, cells=12)
            drawn = ax.collections[0].get_array()
            assert drawn.shape == (9, 12) and np.isfinite(drawn).any()
            assert "px" in ax.get_figure().axes[-1].get_ylabel()
        ax = plot.residual_histogram(made, what=what)
        table = getattr(made.residuals, what)
        inside = np.abs(table.standardised[table.used]) <= 5
        assert sum(p.get_height() for p in ax.patches) == inside.sum()
    with pytest.raises(uwscan.InputError, match="no residuals"):
        plot.residual_map(uwscan.Calibration.load(calibration_file))
    for bad in [{"what": "edges"}, {"show": "max"}, {"medium": "oil"}, {"cells": 0}, {"cells": 100_000}]:
        with pytest.raises(uwscan.InputError):
            plot.residual_map(made, **bad)
