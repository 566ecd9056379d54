"""Clouds, fits, shapes and meshes on arrays, and what is refused."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import uwscan


#: Half a step of coordinates in LAS files, mm, and a rounding.
LAS_HALF_STEP_MM = 5.1e-4


def cap(n: int = 900, radius: float = 20.0, scatter: float = 0.0, seed: int = 1) -> np.ndarray:
    """The near part of a ball 700 mm away, mm."""
    i = np.arange(n)
    z = -1 + 0.8 * i / n
    r, t = np.sqrt(1 - z**2), 2.4 * i
    off = radius + scatter * np.random.default_rng(seed).normal(size=n)
    return np.stack([off * r * np.cos(t), off * r * np.sin(t), 700 + off * z], axis=1)


def test_a_cloud_keeps_what_it_is_given(tmp_path):
    points = cap(50)
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (50, 1, 1))
    cloud = uwscan.Cloud(
        points, intensity=np.arange(50), frame_index=range(50), pixel=points[:, :2], sigma_mm=0.03, covariance_mm2=covariance, shared_mm=points * 1e-4
    )
    np.testing.assert_array_equal(cloud.points_mm, points)
    np.testing.assert_allclose(cloud.covariance_mm2, covariance, rtol=1e-6)
    np.testing.assert_allclose(cloud.shared_mm, points * 1e-4, rtol=1e-6)
    assert cloud.sigma_mm.tolist() == [np.float32(0.03)] * 50 and cloud.frame_index[-1] == 49
    half = cloud.select(cloud.points_mm[:, 0] > 0)
    np.testing.assert_array_equal(half.points_mm, points[points[:, 0] > 0])
    assert half.pixel.shape == (len(half), 2) and cloud.select([3, 1]).frame_index.tolist() == [3, 1]
    with pytest.raises(IndexError):
        cloud.select([50])
    for name in ["cloud.ply", "cloud.csv", "cloud.xyz"]:
        cloud.save(tmp_path / name)
        np.testing.assert_allclose(uwscan.Cloud.load(tmp_path / name).points_mm, points, atol=1e-9)
        np.testing.assert_array_equal(uwscan.Cloud.load(tmp_path / name).shared_mm, cloud.shared_mm)
    with pytest.raises(uwscan.FormatError, match="ends in"):
        cloud.save(tmp_path / "cloud.pcx")
    low, high = cloud.bounding_box_mm
    assert low == list(points.min(axis=0)) and high == list(points.max(axis=0))


def test_what_all_points_share_does_not_average_out():
    points, middle = cap(), np.array([0, 0, 700])
    outwards = (points - middle) / 20
    alone, shared = uwscan.Cloud(points, sigma_mm=0.01), uwscan.Cloud(points, sigma_mm=0.01, shared_mm=0.05 * outwards)
    before, after = uwscan.fit_sphere(alone), uwscan.fit_sphere(shared)
    assert after.radius_mm == pytest.approx(before.radius_mm, abs=1e-9)
    assert after.sigma_radius_mm == pytest.approx(np.hypot(before.sigma_radius_mm, 0.05), rel=0.02)


@pytest.mark.parametrize("name", ["cloud.las", "cloud.laz"])
def test_las_is_there_where_it_was_built_with_or_it_is_said_how(tmp_path, name):
    cloud = uwscan.Cloud(cap(50), intensity=np.arange(50))
    try:
        cloud.save(tmp_path / name)
    except uwscan.FormatError as error:
        assert "built with the feature las" in str(error) and not (tmp_path / name).exists()
        with pytest.raises(uwscan.FormatError, match="built with the feature las"):
            uwscan.Cloud.load(tmp_path / name)
        return
    again = uwscan.Cloud.load(tmp_path / name)
    # Whole steps of what the format is written with.
    np.testing.assert_allclose(again.points_mm, cap(50), atol=LAS_HALF_STEP_MM)
    assert again.intensity.shape == (50,)


def test_lent_arrays_outlive_their_cloud_and_are_read_only():
    points = uwscan.Cloud(cap(1000)).points_mm
    gc.collect()
    np.testing.assert_array_equal(points, cap(1000))
    with pytest.raises(ValueError, match="read-only"):
        points[0, 0] = 1


@pytest.mark.parametrize(
    ("points", "more"),
    [
        (np.zeros((3, 2)), {}),
        (np.zeros(4), {}),
        (np.zeros((2, 2, 3)), {}),
        ([[1, 2, 3], [4, 5]], {}),
        (np.zeros((3, 3), complex), {}),
        (np.array([["a", "b", "c"]]), {}),
        (np.array([[None, 1, 2]]), {}),
        (np.zeros((3, 3)), {"sigma_mm": [1, 2]}),
        (np.zeros((3, 3)), {"frame": "world"}),
        (np.zeros((3, 3)), {"frame_index": [0.5, 1, 2]}),
        (np.zeros((3, 3)), {"frame_index": [-1, 1, 2]}),
        (np.zeros((3, 3)), {"covariance_mm2": np.zeros((3, 2, 2))}),
        (np.zeros((1, 3)), {"covariance_mm2": [[[1, 2, 0], [0, 1, 0], [0, 0, 1]]]}),
        (np.zeros((3, 3)), {"pixel": np.zeros((2, 2))}),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(points, more):
    with pytest.raises(uwscan.InputError) as e:
        uwscan.Cloud(points, **more)
    assert isinstance(e.value, ValueError)


@pytest.mark.parametrize(
    "layout", [np.asfortranarray, lambda a: a[::-1].copy()[::-1], lambda a: np.repeat(a, 2, 1)[:, ::2], np.ndarray.tolist]
)
def test_points_of_any_layout_are_the_same(layout):
    fit = uwscan.fit_sphere(layout(cap()))
    assert abs(fit.radius_mm - 20) < 1e-9
    assert uwscan.fit_sphere(cap().astype(np.float32)).radius_mm == pytest.approx(20, abs=1e-4)


def test_fits_recover_their_shapes():
    sphere = uwscan.fit_sphere(cap(scatter=0.02), sigma_mm=0.02)
    assert abs(sphere.radius_mm - 20) < 5 * sphere.sigma_radius_mm < 0.1
    assert sphere.kind == "sphere" and sphere.points == 900 and sphere.covariance.shape == (4, 4)
    np.testing.assert_allclose(np.sqrt(np.diag(sphere.covariance)), [*sphere.sigma_center_mm, sphere.sigma_radius_mm])
    off = sphere.deviations_mm(cap(scatter=0.02))
    np.testing.assert_allclose(np.sqrt(np.mean(off**2)), sphere.rms_mm, rtol=0.05)
    known = uwscan.fit_sphere(cap(), radius_mm=20.0)
    assert known.sigma_radius_mm == 0 and abs(known.center_mm[2] - 700) < 1e-9

    x, y = np.meshgrid(np.arange(-20.0, 20), np.arange(-20.0, 20))
    flat = np.stack([x, y, 700 + 0.1 * x], axis=-1).reshape(-1, 3)
    plane = uwscan.fit_plane(flat)
    assert np.max(np.abs(plane.deviations_mm(flat))) < 1e-9 and plane.normal[2] < 0
    assert uwscan.fit_plane(flat, sensor_mm=[0, 0, 2000]).normal[2] > 0

    t, h = np.meshgrid(np.linspace(-2.5, -0.6, 60), np.linspace(-30, 30, 40))
    pipe = np.stack([25 * np.cos(t), h, 700 + 25 * np.sin(t)], axis=-1).reshape(-1, 3)
    cylinder = uwscan.fit_cylinder(pipe)
    assert abs(cylinder.radius_mm - 25) < 1e-6 and abs(abs(cylinder.axis_direction[1]) - 1) < 1e-9
    assert cylinder.extent_mm == pytest.approx((-30, 30), abs=1e-6)
    assert np.max(np.abs(cylinder.deviations_mm(pipe))) < 1e-6

    a = np.linspace(0, 5, 90)
    ring = np.stack([25 * np.cos(a), 25 * np.sin(a), np.full(90, 700.0)], axis=1)
    circle = uwscan.fit_circle(ring)
    assert abs(circle.radius_mm - 25) < 1e-9 and circle.normal[2] < 0
    assert np.max(np.abs(circle.deviations_mm(ring))) < 1e-9


def test_shapes_are_found_and_related():
    two = np.concatenate([cap(2500, scatter=0.02), cap(2500, scatter=0.02, seed=2) + [120, 0, 0]])
    shapes = uwscan.find_shapes(two)
    assert [s.kind for s in shapes] == ["sphere", "sphere"] and len(shapes) == 2
    a, b, distance, sigma, total = shapes.distances_mm[0]
    assert (a, b, total) == (0, 1, None) and abs(distance - 120) < 5 * sigma < 0.5
    index = shapes[0].point_index
    assert index.dtype == np.int64 and np.max(np.abs(shapes[0].deviations_mm(two[index]))) < 0.2
    assert len(uwscan.find_shapes(two, max=1)) == 1
    with pytest.raises(IndexError):
        shapes[2]


def test_a_surface_and_its_files(tmp_path):
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    mesh = uwscan.triangulate_surface(np.stack([x, y, np.full_like(x, 700)], -1).reshape(-1, 3))
    assert mesh.area_mm2 == pytest.approx(361)
    assert mesh.triangles.dtype == np.uint32 and mesh.triangles.max() < len(mesh.vertices_mm)
    assert mesh.normals.shape == mesh.vertices_mm.shape and np.allclose(mesh.normals[:, 2], -1)
    assert mesh.point_index.shape == (len(mesh.vertices_mm),)
    for name in ["m.ply", "m.stl", "m.obj"]:
        mesh.save(tmp_path / name)
        assert uwscan.Mesh.load(tmp_path / name).area_mm2 == pytest.approx(361)
    mesh.save(tmp_path / "m.glb")
    rough = cap(900, scatter=0.02)
    smooth = uwscan.triangulate_surface(uwscan.Cloud(rough, sigma_mm=0.02), smooth=True)
    assert np.max(np.abs(smooth.vertices_mm - rough[smooth.point_index])) > 0
    with pytest.raises(uwscan.SurfaceError):
        uwscan.triangulate_surface(rough, smooth=True)
    with pytest.raises(uwscan.FormatError):
        uwscan.Mesh.load(tmp_path / "m.glb")
    with pytest.raises(uwscan.InputError):
        uwscan.Mesh(np.zeros((3, 3)), [[0, 1, 3]])
    with pytest.raises(uwscan.SurfaceError):
        uwscan.triangulate_surface(np.zeros((2, 3)))
    with pytest.raises(uwscan.InputError):
        uwscan.triangulate_surface(np.zeros((9, 3)), steepest_deg=10)


FITS = [uwscan.fit_sphere, uwscan.fit_plane, uwscan.fit_cylinder, uwscan.fit_circle, uwscan.find_shapes]


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((50, 3)), np.full((50, 3), np.nan), np.full((50, 3), np.inf)])
def test_points_without_a_shape_are_an_error(fit, points):
    if fit is uwscan.find_shapes and points.shape[0] and np.isfinite(points).all():
        assert len(fit(points)) == 0
        return
    with pytest.raises(uwscan.FitError) as e:
        fit(points)
    assert isinstance(e.value, ValueError)


def test_settings_of_fits_are_checked(calibration):
    with pytest.raises(uwscan.FitError, match="radius"):
        uwscan.fit_sphere(cap(), radius_mm=-1.0)
    with pytest.raises(uwscan.InputError, match="not both"):
        uwscan.fit_sphere(cap(), sigma_mm=0.1, covariance_mm2=np.zeros((900, 6)))
    with pytest.raises(uwscan.CalibrationError, match="pixels"):
        uwscan.fit_sphere(cap(), calibration=calibration)
    with pytest.raises(uwscan.InputError):
        uwscan.fit_plane(cap(), sensor_mm=[0, 0])
    with pytest.raises(uwscan.InputError):
        uwscan.fit_sphere(cap(), calibration=5)


@given(hnp.arrays(np.float64, st.tuples(st.integers(0, 40), st.just(3)), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_no_points_break_a_fit(points):
    for fit in FITS:
        try:
            fit(points)
        except uwscan.FitError:
            pass
    try:
        uwscan.triangulate_surface(points)
    except uwscan.SurfaceError:
        pass
    assert uwscan.Cloud(points).points_mm.shape == points.shape


def test_cameras_and_windows():
    camera = uwscan.Camera([[1400, 0, 384], [0, 1390, 288], [0, 0, 1]], [-0.2, 0.1, 1e-3, -1e-3, 0.01])
    pixels = np.stack(np.meshgrid(np.linspace(0, 767, 9), np.linspace(0, 575, 7)), -1).reshape(-1, 2)
    np.testing.assert_allclose(camera.project(camera.back_project(pixels)), pixels, atol=1e-9)
    assert np.isnan(camera.project([[0, 0, -1.0], [0, 0, 0], [np.nan, 0, 1]])).all()
    port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
    origins, directions = port.back_project(camera.back_project(pixels), index=1.335)
    seen = port.project(origins + 300 * directions, index=1.335)
    np.testing.assert_allclose(camera.project(seen), pixels, atol=1e-8)
    assert np.isnan(port.project([[0, 0, 5.0]], index=1.335)).all()
    with pytest.raises(uwscan.GeometryError, match="length 1"):
        uwscan.Port([0, 0, 2], 10.0, 8.0, 1.5)
    for matrix in [np.eye(2), np.zeros((3, 3)), [[1, 1, 0], [0, 1, 0], [0, 0, 1]], np.full((3, 3), np.nan)]:
        with pytest.raises(uwscan.InputError):
            uwscan.Camera(matrix)
    with pytest.raises(uwscan.InputError):
        uwscan.Camera(np.eye(3), np.zeros(8))
    for index in [0.5, float("nan"), 10.0]:
        with pytest.raises(uwscan.InputError):
            port.project([[0, 0, 50.0]], index=index)
    with pytest.raises(uwscan.InputError):
        uwscan.Galvo(np.diag([1, 1, -1, 1]), 2.0)
    assert uwscan.Galvo(np.eye(4), 2.0, reference_v=0.5).mirror_angle_rad(1.5) == pytest.approx(np.radians(2))
