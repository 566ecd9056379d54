"""To and from other packages, those that are installed."""

from __future__ import annotations

import numpy as np
import pytest

import uwscan
from uwscan import interchange, viewer


def test_opencv_and_ros(calibration):
    k, dist = interchange.camera_to_opencv(calibration)
    camera = interchange.camera_from_opencv(k, dist.reshape(1, 5))
    pixel = [[100.0, 200.0]]
    np.testing.assert_array_equal(camera.back_project(pixel), calibration.scanner.camera.back_project(pixel))
    info = interchange.camera_to_ros(calibration)
    assert (info["width"], info["height"], info["distortion_model"]) == (768, 576, "plumb_bob") and len(info["p"]) == 12
    again = interchange.camera_from_ros(info)
    np.testing.assert_array_equal(again.camera_matrix, k)
    np.testing.assert_array_equal(interchange.camera_from_ros({"K": info["k"], "D": info["d"]}).distortion, dist)
    assert np.all(interchange.camera_from_opencv(k, np.zeros(14)).distortion == 0)
    for bad in [{"k": [1, 2]}, {}, {**info, "distortion_model": "equidistant"}]:
        with pytest.raises(uwscan.InputError):
            interchange.camera_from_ros(bad)
    with pytest.raises(uwscan.InputError):
        interchange.camera_from_opencv(k, [0, 0, 0, 0, 0, 1, 0, 0])


def test_pandas_and_arrow(cloud):
    pytest.importorskip("pandas")
    frame = interchange.to_pandas(cloud, covariance=True)
    assert len(frame) == len(cloud) and {"x_mm", "u_px", "frame_index", "cov_xz_mm2"} <= set(frame)
    np.testing.assert_array_equal(frame["cov_yz_mm2"], cloud.covariance_mm2[:, 1, 2])
    pytest.importorskip("pyarrow")
    table = interchange.to_arrow(cloud)
    np.testing.assert_array_equal(table["z_mm"].to_numpy(), cloud.points_mm[:, 2])
    assert table.schema.metadata[b"frame"] == b"camera"


def test_xarray(cloud):
    pytest.importorskip("xarray")
    data = interchange.to_xarray(cloud, lines=576)
    assert dict(data.sizes) == {"frame": np.unique(cloud.frame_index).size, "line": 576}
    k = len(cloud) // 2
    cell = data.sel(frame=cloud.frame_index[k], line=round(float(cloud.pixel[k, 1])))
    assert float(cell["x_mm"]) == cloud.points_mm[k, 0] and data["x_mm"].units == "mm"
    assert int(data["z_mm"].notnull().sum()) == len(cloud)
    with pytest.raises(uwscan.InputError):
        interchange.to_xarray(uwscan.Cloud(cloud.points_mm))


def test_pyvista(cloud):
    pytest.importorskip("pyvista")
    data = interchange.to_pyvista(cloud)
    np.testing.assert_array_equal(data.points, cloud.points_mm)
    assert np.shares_memory(data.points, cloud.points_mm)
    mesh = uwscan.triangulate_surface(cloud)
    again = interchange.mesh_from_pyvista(interchange.to_pyvista(mesh))
    assert again.area_mm2 == pytest.approx(mesh.area_mm2)
    assert len(interchange.cloud_from_pyvista(data)) == len(cloud)


def test_open3d(cloud):
    pytest.importorskip("open3d")
    again = interchange.cloud_from_open3d(interchange.to_open3d(cloud))
    np.testing.assert_array_equal(again.points_mm, cloud.points_mm)
    mesh = uwscan.triangulate_surface(cloud)
    assert interchange.mesh_from_open3d(interchange.to_open3d(mesh)).area_mm2 == pytest.approx(mesh.area_mm2)


def test_the_viewer_says_what_is_missing(cloud, monkeypatch):
    monkeypatch.setattr(viewer, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match="pip install"):
        viewer.show(cloud)
    with pytest.raises(ImportError, match="rerun-sdk"):
        viewer.show(cloud, program="rerun")
    with pytest.raises(uwscan.InputError):
        viewer.show(cloud, program="paraview")
