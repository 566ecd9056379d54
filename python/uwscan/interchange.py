"""Data to and from other packages: Open3D, PyVista, pandas, Arrow, xarray, OpenCV, ROS. Each is imported when it is used.

Lengths stay millimetres, except where a function says otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import errors
from ._uwscan import Camera, Cloud, Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._uwscan import Calibration

__all__ = [
    "camera_from_opencv",
    "camera_from_ros",
    "camera_to_opencv",
    "camera_to_ros",
    "cloud_from_open3d",
    "cloud_from_pyvista",
    "mesh_from_open3d",
    "mesh_from_pyvista",
    "to_arrow",
    "to_open3d",
    "to_pandas",
    "to_pyvista",
    "to_xarray",
]

_PACKED = ("xx", "xy", "xz", "yy", "yz", "zz")


def _columns(cloud: Cloud, covariance: bool) -> dict[str, NDArray[Any]]:
    """A cloud's arrays as columns of a table, views where they can be."""
    x, y, z = cloud.points_mm.T
    columns: dict[str, NDArray[Any]] = {"x_mm": x, "y_mm": y, "z_mm": z}
    single = {"intensity": cloud.intensity, "frame_index": cloud.frame_index, "sigma_mm": cloud.sigma_mm}
    columns |= {name: values for name, values in single.items() if values is not None}
    if cloud.pixel is not None:
        columns["u_px"], columns["v_px"] = cloud.pixel.T
    if covariance and cloud.covariance_mm2 is not None:
        upper = zip(*np.triu_indices(3), strict=True)
        columns |= {f"cov_{n}_mm2": cloud.covariance_mm2[:, i, j] for n, (i, j) in zip(_PACKED, upper, strict=True)}
    if covariance and cloud.shared_mm is not None:
        columns |= {f"shared_{n}_mm": cloud.shared_mm[:, i] for i, n in enumerate("xyz")}
    return columns


def to_pandas(cloud: Cloud, *, covariance: bool = False) -> Any:
    """A cloud as a pandas.DataFrame, a row a point: x_mm, y_mm, z_mm and what else the cloud has.

    Parameters
    ----------
    cloud : Cloud
    covariance : bool, default False
        Add the six columns of the covariance, cov_xx_mm2 to cov_zz_mm2, and where the cloud tells it what of that all points
        share, shared_x_mm to shared_z_mm.
    """
    import pandas

    return pandas.DataFrame(_columns(cloud, covariance), copy=False)


def to_arrow(cloud: Cloud, *, covariance: bool = False) -> Any:
    """A cloud as a pyarrow.Table, a row a point, with the columns of `to_pandas`; its frame is in the schema's metadata."""
    import pyarrow

    columns = {name: pyarrow.array(np.ascontiguousarray(v)) for name, v in _columns(cloud, covariance).items()}
    return pyarrow.table(columns).replace_schema_metadata({"frame": cloud.frame, "unit": "mm"})


def to_xarray(cloud: Cloud, *, lines: int | None = None, axis: str = "rows") -> Any:
    """An organised scan as an xarray.Dataset: one cell for each image (``frame``) and line of the image (``line``), NaN where nothing was seen.

    Parameters
    ----------
    cloud : Cloud
        With pixels and frames, as `uwscan.reconstruct` makes it.
    lines : int, optional
        Lines of the image; by default as many as the points need.
    axis : str, default "rows"
        "rows" or "columns": the lines that stripes were measured along (``calibration.axis``).

    Raises
    ------
    InputError
        For a cloud without pixels or frames.
    """
    import xarray

    if cloud.pixel is None or cloud.frame_index is None:
        raise errors.InputError("an organised scan needs the pixels and frames of its points")
    along = np.rint(cloud.pixel[:, 1 if axis == "rows" else 0]).astype(np.int64)
    frames, place = np.unique(cloud.frame_index, return_inverse=True)
    number = int(along.max()) + 1 if lines is None else lines
    shape = (frames.size, number)
    data = {}
    for name, values in _columns(cloud, covariance=False).items():
        if name != "frame_index":
            grid = np.full(shape, np.nan, dtype=values.dtype)
            grid[place, along] = values
            unit = "mm" if name.endswith("_mm") else "px" if name.endswith("_px") else "DN"
            data[name] = (("frame", "line"), grid, {"units": unit})
    return xarray.Dataset(data, {"frame": frames, "line": np.arange(number)}, {"frame": cloud.frame})


def to_open3d(what: Cloud | Mesh) -> Any:
    """A cloud or mesh as Open3D's PointCloud or TriangleMesh (legacy), millimetres. Open3D copies what it is given.

    Examples
    --------
    ``open3d.visualization.draw_geometries([uwscan.interchange.to_open3d(cloud)])``
    """
    import open3d

    vector = open3d.utility.Vector3dVector
    if isinstance(what, Cloud):
        return open3d.geometry.PointCloud(vector(what.points_mm))
    mesh = open3d.geometry.TriangleMesh(
        vector(what.vertices_mm), open3d.utility.Vector3iVector(what.triangles.astype(np.int32))
    )
    if what.normals is not None:
        mesh.vertex_normals = vector(what.normals.astype(np.float64))
    return mesh


def cloud_from_open3d(cloud: Any, *, frame: str = "camera") -> Cloud:
    """Open3D's PointCloud, in millimetres, as a cloud."""
    return Cloud(np.asarray(cloud.points), frame=frame)


def mesh_from_open3d(mesh: Any, *, frame: str = "camera") -> Mesh:
    """Open3D's TriangleMesh, in millimetres, as a mesh."""
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles), frame=frame)


def to_pyvista(what: Cloud | Mesh) -> Any:
    """A cloud or mesh as pyvista.PolyData, millimetres: its points share the memory, attributes are point data."""
    import pyvista

    if isinstance(what, Cloud):
        data = pyvista.PolyData(what.points_mm)
        named = {"intensity": what.intensity, "frame_index": what.frame_index, "sigma_mm": what.sigma_mm}
    else:
        data = pyvista.PolyData.from_regular_faces(what.vertices_mm, what.triangles.astype(np.int64))
        named = {"intensity": what.intensity, "sigma_mm": what.sigma_mm, "Normals": what.normals}
    for name, values in named.items():
        if values is not None:
            data.point_data[name] = values
    return data


def cloud_from_pyvista(data: Any, *, frame: str = "camera") -> Cloud:
    """The points of pyvista.PolyData, in millimetres, as a cloud."""
    return Cloud(np.asarray(data.points), frame=frame)


def mesh_from_pyvista(data: Any, *, frame: str = "camera") -> Mesh:
    """pyvista.PolyData, in millimetres, as a mesh; polygons become triangles."""
    triangles = data.triangulate()
    return Mesh(np.asarray(triangles.points), triangles.regular_faces, frame=frame)


def camera_to_opencv(camera: Camera | Calibration) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """OpenCV's (K, dist): (3, 3) and (5,). They are the camera's in air: OpenCV knows no windows.

    Examples
    --------
    >>> import uwscan
    >>> K, dist = uwscan.interchange.camera_to_opencv(uwscan.Camera([[9, 0, 4], [0, 9, 3], [0, 0, 1]]))
    >>> K[0].tolist(), dist.shape
    ([9.0, 0.0, 4.0], (5,))
    """
    return camera.camera_matrix, camera.distortion


def camera_from_opencv(camera_matrix: ArrayLike, dist: ArrayLike | None = None) -> Camera:
    """A camera from OpenCV's K and 4 or 5 distortion coefficients, of any shape; more of them must be zero.

    Raises
    ------
    InputError
        For coefficients of a model that uwscan does not have (rational, thin prism, tilted).
    """
    coefficients = np.zeros(0) if dist is None else np.asarray(dist, dtype=np.float64).ravel()
    if np.any(coefficients[5:] != 0):
        raise errors.InputError("distortion beyond k3 (rational, thin prism, tilted) is not modelled: calibrate without it")
    return Camera(camera_matrix, coefficients[:5])


def camera_to_ros(calibration: Calibration, *, frame_id: str = "camera") -> dict[str, Any]:
    """The camera as the fields of ROS's sensor_msgs/CameraInfo (plumb_bob), in air.

    Returns
    -------
    dict
        header, width, height, distortion_model, d, k, r, p: lists of numbers, row by row.
    """
    k = calibration.camera_matrix
    width, height = calibration.image_size
    return {
        "header": {"frame_id": frame_id},
        "width": width,
        "height": height,
        "distortion_model": "plumb_bob",
        "d": calibration.distortion.tolist(),
        "k": k.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.hstack([k, np.zeros((3, 1))]).ravel().tolist(),
    }


def camera_from_ros(info: dict[str, Any]) -> Camera:
    """A camera from the fields of ROS's sensor_msgs/CameraInfo, of ROS 1 (K, D) or 2 (k, d).

    Raises
    ------
    InputError
        For another distortion model than plumb_bob, or where fields are missing.
    """
    model = info.get("distortion_model", "plumb_bob")
    if model not in ("plumb_bob", ""):
        raise errors.InputError(f"distortion_model must be plumb_bob, got {model!r}")
    try:
        k, d = info.get("k", info.get("K")), info.get("d", info.get("D", []))
        return camera_from_opencv(np.reshape(np.asarray(k, dtype=np.float64), (3, 3)), d)
    except (TypeError, ValueError) as e:
        raise errors.InputError(f"k must hold nine numbers: {e}") from e
