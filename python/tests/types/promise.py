"""The promised surface as type checkers see it: never run, checked by mypy and pyright."""

from __future__ import annotations

from pathlib import Path
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import uwscan

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def stripes(image: NDArray[np.uint8], stack: NDArray[np.uint16]) -> None:
    stripe = uwscan.extract_stripe(image, axis="rows", method="robust", noise=None, sigma_px=None, threshold=None, roi=None)
    assert_type(stripe, uwscan.Stripe)
    for values in (stripe.position_px, stripe.amplitude, stripe.width_px, stripe.background, stripe.sigma_px, stripe.chi2, stripe.rival_ratio):
        assert_type(values, Singles)
    assert_type(stripe.flags, NDArray[np.uint16])
    print(uwscan.StripeFlags(int(stripe.flags[0])).name)
    noise = uwscan.NoiseModel(40.0, 1.0, speckle_contrast=0.0, full_scale_dn=255)
    uwscan.extract_stripe(stack, method="precise", noise=noise, sigma_px=2.0, threshold=5.0, roi=(0, 0, 64, 64), out=stripe)
    assert_type(uwscan.NoiseModel.from_flat_fields([stack, stack]), uwscan.NoiseModel)


def jobs(folder: Path) -> None:
    capture = uwscan.open_capture(folder)
    for frame in capture:
        assert_type(frame.laser_on, bool)
        uwscan.extract_stripe(frame.image)
    calibration = uwscan.calibrate([capture, folder], rig=None, method="joint")
    uwscan.calibrate(folder, report="calibration.html", made="2026-11-29", overwrite=True)
    assert_type(uwscan.Calibration.load("calibration.toml"), uwscan.Calibration)
    calibration.save(folder)
    for known in (calibration.camera_matrix, calibration.distortion, calibration.axis_point_mm, calibration.axis_direction):
        assert_type(known, Floats)
    assert_type(calibration.sigmas, dict[str, float])
    assert_type(calibration.covariance, Floats | None)
    cloud = uwscan.reconstruct(
        capture, calibration, refraction="exact", frame="camera", stripe="robust", threads=None, progress=lambda stage, done, total: None
    )
    assert_type(cloud.points_mm, Floats)
    assert_type(cloud.intensity, Singles | None)
    assert_type(cloud.frame_index, NDArray[np.uint32] | None)
    assert_type(cloud.pixel, Singles | None)
    assert_type(cloud.sigma_mm, Singles | None)
    assert_type(cloud.covariance_mm2, Singles | None)
    cloud.save("cloud.ply")
    assert_type(uwscan.Cloud.load("cloud.ply"), uwscan.Cloud)
    assert_type(uwscan.simulate("scene.toml", "rig.toml", output=folder), Path)
    remains = calibration.residuals
    if remains is not None:
        assert_type(remains.corners.residual_px, Floats)


def shapes(points: Floats, cloud: uwscan.Cloud, calibration: uwscan.Calibration) -> None:
    sphere = uwscan.fit_sphere(points, covariance_mm2=None, sigma_mm=0.1, radius_mm=None, calibration=None)
    assert_type(sphere.radius_mm, float)
    assert_type(sphere.sigma_total_radius_mm, float | None)
    assert_type(uwscan.fit_plane(cloud, calibration=calibration).normal, Floats)
    assert_type(uwscan.fit_cylinder(cloud).axis_direction, Floats)
    assert_type(uwscan.fit_circle(cloud).center_mm, Floats)
    for shape in uwscan.find_shapes(cloud):
        assert_type(shape, uwscan.SphereFit | uwscan.PlaneFit | uwscan.CylinderFit)
    mesh = uwscan.triangulate_surface(cloud)
    assert_type(mesh.vertices_mm, Floats)
    assert_type(mesh.triangles, NDArray[np.uint32])
    mesh.save("mesh.stl")
    assert_type(uwscan.compare(cloud, mesh).deviations_mm, Singles)
    assert_type(uwscan.merge([cloud, points]).cloud, uwscan.Cloud)
    assert_type(cloud.select(~uwscan.find_outliers(cloud)), uwscan.Cloud)


def model(points: Floats, calibration: uwscan.Calibration) -> None:
    camera = uwscan.Camera(np.eye(3), [0.0] * 5)
    assert_type(camera.project(camera.back_project(points[:, :2])), Floats)
    port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
    fan = uwscan.Fan([0, 0, -90])
    assert_type(port.back_project(points, index=1.335), tuple[Floats, Floats])
    galvo = uwscan.Galvo(np.eye(4), 2.0)
    scanner = uwscan.Scanner(camera, port, galvo, fan, port)
    assert_type(scanner.project(points, index=1.335), Floats)
    assert_type(scanner.triangulate(points[:, :2], 0.5, index=1.335), Floats)
    assert_type(calibration.scanner, uwscan.Scanner)
    uwscan.water_index(20.0, 35.0, 532.0, depth_m=0.0)


def figures(image: NDArray[np.uint8], cloud: uwscan.Cloud, calibration: uwscan.Calibration) -> None:
    uwscan.plot.stripe(image, uwscan.extract_stripe(image))
    uwscan.plot.cloud(cloud, by="sigma")
    uwscan.plot.deviations(cloud, uwscan.fit_sphere(cloud))
    uwscan.plot.residual_map(calibration, what="stripes", show="mean")


def errors() -> None:
    try:
        uwscan.open_capture("nowhere")
    except uwscan.MissingFileError as e:
        assert_type(e.noticed, list[str])
    assert issubclass(uwscan.UwscanError, Exception)
