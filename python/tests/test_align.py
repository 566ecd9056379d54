"""Clouds against a reference, and together: what comes back is what was put in."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import uwscan

#: Standard deviation of the points' noise, mm.
SIGMA_MM = 0.02


def terrain(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A surface that looks like itself in one way round only, mm."""
    z = 700 + 4 * np.sin(u / 11) * np.cos(v / 17) + 0.05 * u + 6 * np.exp(-((u - 20) ** 2 + (v + 12) ** 2) / 90)
    return np.stack([u, v, z], axis=-1)


def mesh(step: float = 1.0) -> uwscan.Mesh:
    u, v = np.meshgrid(np.arange(-60, 60 + step, step), np.arange(-45, 45 + step, step))
    rows, columns = u.shape
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    # Towards the sensor at the origin.
    triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return uwscan.Mesh(terrain(u, v).reshape(-1, 3), triangles)


def turned(points: np.ndarray, degrees: float = 4.0, shift: tuple[float, float, float] = (6.0, -3.0, 5.0)) -> tuple[np.ndarray, np.ndarray]:
    """Points moved by a turn about z through their middle and a shift, and the matrix that moves them back."""
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    middle = points.mean(axis=0)
    moved = (points - middle) @ turn.T + middle + shift
    back = np.eye(4)
    back[:3, :3] = turn.T
    back[:3, 3] = middle - turn.T @ (middle + shift)
    return moved, back


def measured(seed: int = 1, half: float = 40.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    u, v = random.uniform(-half, half, 6000), random.uniform(-30, 30, 6000)
    return terrain(u, v) + random.normal(0, SIGMA_MM, (6000, 3)) * [0, 0, 1]


def test_a_moved_cloud_comes_back_onto_its_reference():
    points, back = turned(measured())
    found = uwscan.compare(uwscan.Cloud(points, sigma_mm=SIGMA_MM, covariance_mm2=np.tile(np.diag([1e-8, 1e-8, SIGMA_MM**2]), (6000, 1, 1))), mesh())
    pose = found.reference_from_cloud
    there = points @ pose[:3, :3].T + pose[:3, 3]
    assert np.max(np.linalg.norm(there - (points @ back[:3, :3].T + back[:3, 3]), axis=1)) < 0.05
    # Facets of 1 mm on this surface lie off it by up to 0.01 mm.
    assert abs(found.rms_mm - SIGMA_MM) < 0.2 * SIGMA_MM and found.overlap > 0.95
    assert found.deviations_mm.shape == (6000,) and found.compared + found.beyond == 6000
    assert found.within_sigmas[0] == pytest.approx(0.68, abs=0.08) and found.covariance.shape == (6, 6)
    assert found.undetermined == [] and found.rivals.shape == (0, 4, 4)
    counts, edges = found.histogram()
    assert counts.sum() == found.compared and edges.shape == (counts.size + 1,)
    np.testing.assert_array_equal(found.cloud.deviation_mm, found.deviations_mm)
    np.testing.assert_array_equal(found.cloud.points_mm, points)


def test_what_is_compared_where_it_is_keeps_its_offset(tmp_path):
    with pytest.warns(uwscan.UwscanWarning, match="open"):
        found = uwscan.compare(measured() - [0, 0, 0.5], mesh(), align=False)
    # The triangles face the sensor, and so does the offset.
    assert abs(found.mean_mm - 0.5) < 0.02 and found.reference_from_cloud is None and found.within_sigmas is None
    mesh().save(tmp_path / "reference.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", uwscan.UwscanWarning)
        same = uwscan.compare(mesh(2.0), tmp_path / "reference.ply", near_mm=1.0)
    assert same.rms_mm < 1e-3


def test_what_does_not_lie_on_a_reference_is_an_error():
    ball = np.random.default_rng(1).normal(size=(4000, 3))
    ball = 30 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0, 0, 700]
    with pytest.raises(uwscan.AlignmentError):
        uwscan.compare(ball, mesh())
    with pytest.raises(uwscan.AlignmentError, match="area"):
        uwscan.compare(ball, uwscan.Mesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]]))
    for settings in [{"least_overlap": 2.0}, {"near_mm": -1.0}, {"align": False, "near_mm": 1.0}]:
        with pytest.raises(uwscan.InputError):
            uwscan.compare(ball, mesh(), **settings)
    with pytest.raises(uwscan.DtypeError, match="reference"):
        uwscan.compare(ball, 5)


def test_two_sweeps_become_one_cloud():
    first = measured(1)[measured(1)[:, 0] < 25]
    second = measured(2)[measured(2)[:, 0] > -25]
    moved, back = turned(second)
    sigmas = np.diag([1e-8, 1e-8, SIGMA_MM**2])
    clouds = [uwscan.Cloud(p, covariance_mm2=np.tile(sigmas, (len(p), 1, 1)), sigma_mm=SIGMA_MM) for p in (first, moved)]
    merged = uwscan.merge(clouds)
    assert len(merged.cloud) == len(first) + len(second) and merged.poses.shape == (2, 4, 4)
    np.testing.assert_array_equal(merged.poses[0], np.eye(4))
    off = merged.cloud.points_mm[len(first) :] - second
    assert np.max(np.linalg.norm(off, axis=1)) < 0.15, "what was moved is back"
    assert merged.covariances.shape == (2, 6, 6) and {p["points_of"] for p in merged.pairs} == {0, 1}
    assert all(0.2 < p["overlap"] <= 1 and p["rms_mm"] < 3 * SIGMA_MM for p in merged.pairs)
    assert merged.cloud.frame_index is None and merged.cloud.covariance_mm2.shape == (len(merged.cloud), 3, 3)
    with pytest.raises(uwscan.AlignmentError, match="at least 2"):
        uwscan.merge(clouds[:1])
    with pytest.raises(uwscan.AlignmentError):
        uwscan.merge([clouds[0], np.random.default_rng(3).uniform(-30, 30, (500, 3)) + [0, 0, 900]])
    with pytest.raises(uwscan.InputError):
        uwscan.merge(5)
