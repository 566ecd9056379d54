"""Care of clouds: what is taken out is what was put in."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import FIXTURES

import uwscan


def sheet(n: int = 60, spacing: float = 0.5) -> np.ndarray:
    x, y = np.meshgrid(spacing * np.arange(n), spacing * np.arange(n))
    return np.stack([x, y, 700 + 0.1 * x], axis=-1).reshape(-1, 3)


def test_planted_points_are_found_and_nothing_else():
    points = sheet()
    strays = np.random.default_rng(1).choice(len(points), 12, replace=False)
    points[strays, 2] -= np.linspace(20, 60, 12)
    np.testing.assert_array_equal(np.flatnonzero(uwscan.find_outliers(points)), np.sort(strays))
    for bad in [0.5, 1000, float("nan")]:
        with pytest.raises(uwscan.InputError, match="limit_sigmas"):
            uwscan.find_outliers(points, limit_sigmas=bad)
    with pytest.raises(uwscan.InputError):
        uwscan.find_outliers(np.full((20, 3), np.nan))


def test_a_sweeps_neighbours_tell_points_off_their_surface(cloud):
    points = cloud.points_mm.copy()
    chosen = np.arange(50, len(points), 97)
    points[chosen] *= 1 - 40 * cloud.sigma_mm[chosen, None] / 700
    moved = uwscan.Cloud(points, frame_index=cloud.frame_index, pixel=cloud.pixel, sigma_mm=cloud.sigma_mm)
    found = uwscan.find_outliers(moved)
    assert found[chosen].mean() > 0.9, "forty sigmas towards the sensor"
    assert np.delete(found, chosen).mean() < 0.03


def test_normals_face_the_sensor(tmp_path):
    truth = np.array([0.1, 0, -1]) / np.hypot(0.1, 1)
    cloud = uwscan.estimate_normals(sheet())
    assert np.max(np.abs(cloud.normals - truth)) < 1e-6
    away = uwscan.estimate_normals(sheet(), sensor_mm=[0, 0, 2000])
    assert np.max(np.abs(away.normals + truth)) < 1e-6
    cloud.save(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(uwscan.Cloud.load(tmp_path / "cloud.ply").normals, cloud.normals)
    assert not uwscan.estimate_normals([[0, 0, 1], [1, 0, 1], [2, 0, 1]]).normals.any(), "three points on a line tell none"
    with pytest.raises(uwscan.InputError, match="neighbours"):
        uwscan.estimate_normals(sheet(), neighbours=2)


def test_fewer_points_lie_where_all_did():
    points = sheet()
    few = uwscan.thin(points, spacing_mm=5.0).points_mm
    assert len(few) == 36 and (few[:, None] == points[None]).all(axis=2).any(axis=1).all()
    flat = uwscan.thin(points, flat_mm=0.05)
    assert len(flat) < 100 and np.max(np.abs(flat.points_mm[:, 2] - 700 - 0.1 * flat.points_mm[:, 0])) < 1e-9
    mean = uwscan.average(uwscan.Cloud(points, sigma_mm=0.1, frame_index=np.arange(len(points))), spacing_mm=5.0)
    assert np.max(np.abs(mean.points_mm[:, 2] - 700 - 0.1 * mean.points_mm[:, 0])) < 1e-9
    # A hundred points of a hundred images each.
    assert np.allclose(np.sort(mean.sigma_mm)[:9], 0.01, rtol=0.05)
    for bad in [{}, {"spacing_mm": 0.0}, {"flat_mm": -1}, {"spacing_mm": 1.0, "flat_mm": 1.0}]:
        with pytest.raises(uwscan.InputError):
            uwscan.thin(points, **bad)
    with pytest.raises(uwscan.InputError):
        uwscan.average(points, spacing_mm=float("inf"))
    with pytest.raises(uwscan.InputError):
        uwscan.thin(np.full((4, 3), np.inf), spacing_mm=1.0)


def test_a_report_is_a_page_with_its_figures(cloud, calibration_file, tmp_path):
    import json

    cloud.save(tmp_path / "ball.ply")
    page = uwscan.report([tmp_path / "ball.ply"], tmp_path / "report.html", calibration=calibration_file, title="A ball", progress=False)
    assert page == tmp_path / "report.html" and "A ball" in page.read_text()
    figures = json.loads((tmp_path / "report.json").read_text())
    sphere = next(s for s in figures["scans"][0]["shapes"] if s["kind"] == "sphere")
    radius = next(f for f in sphere["figures"] if f["name"] == "radius_mm")
    off_mm = abs(radius["value"] - 20.0175)
    assert off_mm < 0.03 and off_mm < 4 * radius["sigma_total"] < 0.1, radius
    assert (tmp_path / "report.csv").is_file()
    with pytest.raises(uwscan.ExistingFileError):
        uwscan.report([tmp_path / "ball.ply"], page, calibration=calibration_file)
    for scans, output, error in [
        ([tmp_path / "ball.ply"], "report.txt", uwscan.InputError),
        ([], "other.html", uwscan.InputError),
        ([FIXTURES / "ball"], "other.html", uwscan.InputError),
        ([tmp_path / "none.ply"], "other.html", uwscan.MissingFileError),
    ]:
        with pytest.raises(error):
            uwscan.report(scans, tmp_path / output)


def test_how_well_an_index_is_known_counts(calibration, cloud):
    given = uwscan.reconstruct(FIXTURES / "ball", calibration, water_index=cloud.report["index"] + 5e-4)
    with pytest.warns(uwscan.UwscanWarning, match="index_sigma="):
        uncertain = uwscan.fit_sphere(given, calibration=calibration)
    exact = uwscan.fit_sphere(given, calibration=calibration, index_sigma=0.0)
    wide = uwscan.fit_sphere(given, calibration=calibration, index_sigma=0.01)
    assert exact.sigma_total_center_mm[2] < wide.sigma_total_center_mm[2]
    assert exact.radius_mm == uncertain.radius_mm
    shapes = uwscan.find_shapes(given, calibration=calibration, index_sigma=0.01, max=1)
    assert shapes[0].kind == "sphere" and shapes[0].sigma_total_center_mm[2] > exact.sigma_total_center_mm[2]
    for bad in [{"index_sigma": 0.01}, {"calibration": calibration, "index_sigma": -1.0}]:
        with pytest.raises(uwscan.InputError, match="index_sigma"):
            uwscan.fit_sphere(given, **bad)
