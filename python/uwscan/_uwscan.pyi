# Generated from the Rust sources by `scripts/python.sh stubs`: change those.
"""
The compiled part of uwscan; import `uwscan` instead.
"""

import collections.abc
import os
import pathlib
import typing
import numpy.typing
from collections.abc import Iterator
from numpy import bool_, float32, float64, int64, uint16, uint32, uint8
from numpy.typing import NDArray
from os import PathLike
from pathlib import Path
from typing import Final, SupportsFloat, SupportsIndex, final

__all__ = ["__version__", "Calibration", "Camera", "CameraFit", "Capture", "CircleFit", "Cloud", "Comparison", "CylinderFit", "Fan", "Frame", "Frames", "Galvo", "Merged", "Mesh", "NoiseModel", "PlaneFit", "Port", "ResidualTable", "Residuals", "Scanner", "Shapes", "SphereFit", "Stripe", "average", "batch_fail", "batch_jobs", "batch_one", "batch_table", "calibrate", "calibrate_camera", "compare", "estimate_normals", "extract_stripe", "find_outliers", "find_shapes", "fit_circle", "fit_cylinder", "fit_plane", "fit_sphere", "merge", "open_capture", "reconstruct", "report", "simulate", "stripe_codes", "thin", "triangulate_surface", "water_index"]

__version__: Final[str]

@final
class Calibration:
    """
    The instrument as a calibration estimated it: camera, both windows, galvanometer, laser fan, and the water's index. Camera frame (x right,
    y down, z forward), millimetres, pixels; pixel (0, 0) is the centre of the top-left one.

    Made by ``uwscan.calibrate`` or ``Calibration.load``.
    """
    def __repr__(self, /) -> str: ...
    @property
    def axis(self, /) -> str:
        """
        Lines that stripes are measured along: ``"rows"`` or ``"columns"``.
        """
    @property
    def axis_direction(self, /) -> NDArray[float64]:
        """
        Unit vector along the mirror's axis, (3,) float64, camera frame.
        """
    @property
    def axis_point_mm(self, /) -> NDArray[float64]:
        """
        The mirror axis's point nearest the optical centre, (3,) float64, camera frame, mm.
        """
    @property
    def camera_from_galvo(self, /) -> NDArray[float64]:
        """
        Galvanometer frame in the camera frame, (4, 4) float64, mm: ``p_camera = camera_from_galvo @ [*p_galvo, 1]``.
        """
    @property
    def camera_matrix(self, /) -> NDArray[float64]:
        """
        K, (3, 3) float64, px: as OpenCV has it.
        """
    @property
    def covariance(self, /) -> NDArray[float64] | None:
        """
        Covariance of small changes of the instrument, (34, 34) float64, in the order and units of `covariance_names`; None for the
        paper's method, which gives none.
        """
    @property
    def covariance_names(self, /) -> list[str]:
        """
        Names of the covariance's rows.
        """
    @property
    def distortion(self, /) -> NDArray[float64]:
        """
        Distortion (k1, k2, p1, p2, k3), (5,) float64: OpenCV's order and sense.
        """
    @property
    def image_size(self, /) -> tuple[int, int]:
        """
        Width and height of an image, px.
        """
    @staticmethod
    def load(path: str | PathLike[str]) -> Calibration:
        """
        The calibration of a file.

        Raises
        ------
        FileError, FormatError
            Where the file can't be read, or holds what no calibration holds.
        """
    @property
    def method(self, /) -> str:
        """
        ``"joint"`` or ``"paper"``.
        """
    @property
    def rejected(self, /) -> list[tuple[str, str]]:
        """
        Images that were left out, with the reason.
        """
    @property
    def residuals(self, /) -> Residuals | None:
        """
        What remained of every corner and stripe point; None for a calibration that was read from a file, which does not hold them, and for one by the
        paper's method.
        """
    def save(self, /, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """
        Writes a calibration file (TOML), whole or not at all.

        Raises
        ------
        ExistingFileError
            Where the file exists, unless `overwrite` is true.
        FileError
            Where it can't be written.
        """
    @property
    def scanner(self, /) -> Scanner:
        """
        The exact model of the instrument.
        """
    @property
    def sigmas(self, /) -> dict[str, float]:
        """
        Standard deviation of every figure by its name; empty without a covariance.
        """
    @property
    def statistics(self, /) -> dict[str, float]:
        """
        What remained: root mean squares, and how many took part.
        """
    @property
    def values(self, /) -> dict[str, float]:
        """
        Every figure of the instrument by its name, which ends in its unit.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What to know before trusting the calibration.
        """
    def water_index(self, /, nominal: SupportsFloat | SupportsIndex | None = None) -> float | None:
        """
        The water's index at the laser's wavelength, relative to air, during a scan whose nominal index is `nominal` (the calibration's own by
        default); None for a calibration on land where none is given.
        """

@final
class Camera:
    """
    A pinhole camera in air with Brown–Conrady distortion (OpenCV's). Pixel (0, 0) is the centre of the top-left pixel.

    Parameters
    ----------
    camera_matrix : array_like
        K, (3, 3), px; without skew.
    distortion : array_like, optional
        (k1, k2, p1, p2[, k3]); none by default.

    Raises
    ------
    InputError
        For a matrix that is none of a camera's.

    Examples
    --------
    >>> import uwscan
    >>> camera = uwscan.Camera([[1400, 0, 384], [0, 1400, 288], [0, 0, 1]])
    >>> camera.project([[0.1, 0.0, 1.0]]).tolist()
    [[524.0, 288.0]]
    """
    def __new__(cls, /, camera_matrix: numpy.typing.ArrayLike, distortion: numpy.typing.ArrayLike | None = None) -> Camera: ...
    def __repr__(self, /) -> str: ...
    def back_project(self, /, pixels: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Directions in air from which light at pixels arrives.

        Parameters
        ----------
        pixels : array_like
            (u, v), (n, 2), px.

        Returns
        -------
        numpy.ndarray
            (n, 3) float64, camera frame, z = 1; NaN where the distortion can't be undone.
        """
    @property
    def camera_matrix(self, /) -> NDArray[float64]:
        """
        K, (3, 3) float64, px.
        """
    @property
    def distortion(self, /) -> NDArray[float64]:
        """
        (k1, k2, p1, p2, k3), (5,) float64.
        """
    def project(self, /, directions: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Pixels at which light from directions in air (or from points in air, with the camera at the origin) is seen.

        Parameters
        ----------
        directions : array_like
            (n, 3), camera frame, any length.

        Returns
        -------
        numpy.ndarray
            (u, v), (n, 2) float64, px; NaN for what is not in front of the camera.
        """

@final
class CameraFit:
    """
    A camera in air from photographs of a chessboard, and how well they determine it.

    Made by ``uwscan.calibrate_camera``.
    """
    def __repr__(self, /) -> str: ...
    @property
    def camera(self, /) -> Camera:
        """
        The camera, for the exact model: ``project``, ``back_project``.
        """
    @property
    def camera_matrix(self, /) -> NDArray[float64]:
        """
        K, (3, 3) float64, px.
        """
    def corners(self, /, image: SupportsIndex) -> NDArray[float64]:
        """
        Corners of one of ``files``: (n, 4) float64, (u, v) as seen and (u, v) as predicted, px.

        Raises
        ------
        IndexError
            Where there is no such image.
        """
    @property
    def covariance(self, /) -> NDArray[float64]:
        """
        Covariance of the camera's figures in the order of ``sigmas``, (9, 9) float64.
        """
    @property
    def distortion(self, /) -> NDArray[float64]:
        """
        (k1, k2, p1, p2, k3), (5,) float64, as OpenCV has them.
        """
    @property
    def files(self, /) -> list[str]:
        """
        The images that show the board.
        """
    @property
    def image_rms_px(self, /) -> NDArray[float64]:
        """
        The same of each image of ``files``.
        """
    @property
    def image_size(self, /) -> tuple[int, int]:
        """
        Width and height of the images, px.
        """
    @property
    def rejected(self, /) -> list[tuple[str, str]]:
        """
        Images that were left out, and why.
        """
    @property
    def rms_px(self, /) -> float:
        """
        Root mean square distance between corners seen and predicted, px, outliers left out.
        """
    @property
    def sigmas(self, /) -> dict[str, typing.Any]:
        """
        Standard deviations by name: fx, fy, cx, cy (px), k1, k2, p1, p2, k3.
        """

@final
class Capture:
    """
    A capture: images of a target or of a scene, each with its voltage, in a folder or in a recording (.mcap).

    A sequence of `Frame`; images are decoded when they are asked for. ``uwscan.open_capture`` opens one; it closes at the end of a
    ``with``, or by itself.

    Examples
    --------
    >>> import uwscan
    >>> with uwscan.open_capture("fixtures/ball") as capture:
    ...     len(capture), capture.kind, capture[1].image.shape
    (43, 'scan', (576, 768))
    """
    def __enter__(self, /) -> Capture: ...
    def __exit__(self, /, *_details: object) -> None: ...
    def __getitem__(self, index: SupportsIndex, /) -> Frame: ...
    def __iter__(self, /) -> Frames: ...
    def __len__(self, /) -> int: ...
    def __repr__(self, /) -> str: ...
    def close(self, /) -> None:
        """
        Frees the recording's file; frames that were taken out of it keep it open.
        """
    def content_hash(self, /) -> str:
        """
        SHA-256, in hexadecimal, of all that the capture says; its name doesn't count.

        Raises
        ------
        FileError
            Where a file cannot be read.
        """
    @property
    def kind(self, /) -> str:
        """
        ``"scan"`` or ``"calibration"``.
        """
    @property
    def medium(self, /) -> str:
        """
        What is outside the windows: ``"air"`` or ``"water"``.
        """
    @property
    def path(self, /) -> Path:
        """
        The folder, or the recording's file.
        """
    @property
    def problems(self, /) -> list[str]:
        """
        What is wrong with the capture and can be gone on without: warnings, and images that are lost.
        """

@final
class CircleFit:
    """
    A fitted circle: a curve in space, such as an edge. Millimetres, in the points' frame.
    """
    def __repr__(self, /) -> str: ...
    @property
    def center_mm(self, /) -> NDArray[float64]:
        """
        Centre, (3,) float64, mm.
        """
    @property
    def covariance(self, /) -> NDArray[float64]:
        """
        Covariance of the parameters from the points alone, float64.
        """
    @property
    def covariance_total(self, /) -> NDArray[float64] | None:
        """
        Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
        """
    def deviations_mm(self, /, points_mm: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).

        Parameters
        ----------
        points_mm : array_like
            (n, 3), mm, in the frame of the fitted points.

        Returns
        -------
        numpy.ndarray
            (n,) float64, mm.
        """
    @property
    def kind(self, /) -> str:
        """
        ``"circle"``
        """
    @property
    def max_inside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the inside, mm.
        """
    @property
    def max_outside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
        """
    @property
    def normal(self, /) -> NDArray[float64]:
        """
        Unit normal of its plane towards the sensor, (3,) float64.
        """
    @property
    def outliers(self, /) -> int:
        """
        Points rejected: farther off than their sigma and the number of points explain.
        """
    @property
    def point_index(self, /) -> NDArray[int64] | None:
        """
        Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
        """
    @property
    def points(self, /) -> int:
        """
        Points that the shape was fitted to.
        """
    @property
    def radius_mm(self, /) -> float:
        """
        Radius, mm.
        """
    @property
    def rms_mm(self, /) -> float:
        """
        Root mean square of the fitted points' orthogonal distances, mm.
        """
    @property
    def sigma_center_mm(self, /) -> NDArray[float64]:
        """
        Standard deviations of the centre, (3,) float64, mm.
        """
    @property
    def sigma_normal_rad(self, /) -> float:
        """
        Standard deviation of the normal in its least certain direction, rad.
        """
    @property
    def sigma_radius_mm(self, /) -> float:
        """
        Standard deviation of the radius, mm; 0 where it was given.
        """
    @property
    def sigma_total_radius_mm(self, /) -> float | None:
        """
        Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        """
    @property
    def statistics(self, /) -> dict[str, typing.Any]:
        """
        All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
        """

@final
class Cloud:
    """
    A point cloud in millimetres. Its arrays are read-only views of its own memory; copy what is to be changed.

    Parameters
    ----------
    points_mm : array_like
        Positions, (n, 3), mm.
    frame : str, default "camera"
        "camera" (x right, y down, z forward) or "galvo" (x along the mirror's axis).
    intensity : array_like, optional
        Brightness of the stripe, (n,), DN.
    frame_index : array_like, optional
        Image that a point was seen in, (n,).
    pixel : array_like, optional
        Stripe centre (u, v) in the raw image, (n, 2), px.
    sigma_mm : array_like, optional
        Standard deviation along the least certain direction, (n,), mm.
    covariance_mm2 : array_like, optional
        Covariance of each measurement, (n, 3, 3), or (n, 6) as xx, xy, xz, yy, yz, zz, mm².
    shared_mm : array_like, optional
        What of their error all points share: each one's step where that is off by one standard deviation, (n, 3), mm. Part of
        the covariance, too.

    Raises
    ------
    InputError
        For arrays of another shape, or of other lengths.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> cloud = uwscan.Cloud(np.zeros((5, 3)), sigma_mm=0.1)
    >>> len(cloud), cloud.sigma_mm.shape, cloud.pixel is None
    (5, (5,), True)
    """
    def __len__(self, /) -> int: ...
    def __new__(cls, /, points_mm: numpy.typing.ArrayLike, *, frame: str = "camera", intensity: numpy.typing.ArrayLike | None = None, frame_index: numpy.typing.ArrayLike | None = None, pixel: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, covariance_mm2: numpy.typing.ArrayLike | None = None, shared_mm: numpy.typing.ArrayLike | None = None) -> Cloud: ...
    def __repr__(self, /) -> str: ...
    @property
    def bounding_box_mm(self, /) -> tuple[list[float], list[float]] | None:
        """
        Lowest and highest corner of the box around all points, mm; None for a cloud without points.
        """
    @property
    def covariance_mm2(self, /) -> NDArray[float32] | None:
        """
        Covariance of each measurement, (n, 3, 3) float32, mm²; None where the cloud has none. Made at the first look.
        """
    @property
    def deviation_mm(self, /) -> NDArray[float32] | None:
        """
        Signed distance of each point from a reference, (n,) float32, mm, as ``uwscan.compare`` measured or a file tells it; None where the cloud has
        none.
        """
    @property
    def frame(self, /) -> str:
        """
        Frame of the coordinates: ``"camera"`` or ``"galvo"``.
        """
    @property
    def frame_index(self, /) -> NDArray[uint32] | None:
        """
        Image that each point was seen in, (n,) uint32; None where the cloud has none.
        """
    @property
    def intensity(self, /) -> NDArray[float32] | None:
        """
        Brightness of the stripe, (n,) float32, DN; None where the cloud has none.
        """
    @staticmethod
    def load(path: str | PathLike[str]) -> Cloud:
        """
        The cloud of a file: .ply, .pcd, .xyz, .csv or .e57; .las and .laz where the module was built with its feature ``las``.

        Raises
        ------
        FileError, FormatError
            Where the file can't be read, or holds what no cloud holds.
        """
    @property
    def normals(self, /) -> NDArray[float32] | None:
        """
        Unit normals of the surface, (n, 3) float32, towards the sensor; (0, 0, 0) where the neighbours tell none. None where the cloud has none:
        ``uwscan.estimate_normals`` makes them.
        """
    @property
    def pixel(self, /) -> NDArray[float32] | None:
        """
        Stripe centre (u, v) in the raw image, (n, 2) float32, px; (0, 0) is the centre of the top-left pixel. None where the cloud has none.
        """
    @property
    def points_mm(self, /) -> NDArray[float64]:
        """
        Positions, (n, 3) float64, mm.
        """
    @property
    def report(self, /) -> dict[str, typing.Any] | None:
        """
        What ``uwscan.reconstruct`` tells besides the points: images used, rows without a point by reason, the index of refraction outside the
        windows, warnings, losses. None for another cloud.
        """
    def save(self, /, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """
        Writes the cloud, whole or not at all: .ply or .pcd (binary), .xyz, .csv or .e57 (.las and .laz with the
        feature ``las``); what a format can't hold is left out.

        Raises
        ------
        ExistingFileError
            Where the file exists, unless `overwrite` is true.
        FormatError
            For a name with another ending.
        """
    def select(self, /, index: numpy.typing.ArrayLike) -> Cloud:
        """
        The points of an index array or mask, with all that they have.

        Raises
        ------
        IndexError
            As NumPy's indexing.
        """
    @property
    def shared_mm(self, /) -> NDArray[float32] | None:
        """
        What of their error all points share, as that of the sheet's thickness: each one's step where that is off by one standard deviation, (n, 3)
        float32, mm. It is part of the covariance, does not average out, and is in the sigmas of what is fitted. None where the cloud tells none.
        """
    @property
    def sigma_mm(self, /) -> NDArray[float32] | None:
        """
        Standard deviation along the least certain direction, (n,) float32, mm; None where the cloud has none.
        """

@final
class Comparison:
    """
    A cloud's distances from a reference, and the alignment that they were measured after. Made by ``uwscan.compare``.
    """
    def __repr__(self, /) -> str: ...
    @property
    def beyond(self, /) -> int:
        """
        Points beyond a border of the reference.
        """
    @property
    def cloud(self, /) -> Cloud:
        """
        The cloud where it was, with each point's ``deviation_mm``: files keep it.
        """
    @property
    def compared(self, /) -> int:
        """
        Points that were compared.
        """
    @property
    def covariance(self, /) -> NDArray[float64] | None:
        """
        Covariance of the alignment, (6, 6) float64: turn about the cloud's moved middle, rad, and shift, mm, both along the reference's axes.
        Errors that points share are not in it. None without alignment.
        """
    @property
    def deviations_mm(self, /) -> NDArray[float32]:
        """
        Signed distance of each point, (n,) float32, mm, positive on the side that the reference faces; NaN beyond a border of it.
        """
    @property
    def extremes_mm(self, /) -> tuple[float, float]:
        """
        The farthest inside and outside, mm.
        """
    def histogram(self, /) -> tuple[numpy.typing.NDArray[numpy.int64], numpy.typing.NDArray[numpy.float64]]:
        """
        How many points lie how far off, over ± four robust standard deviations about the median.

        Returns
        -------
        counts, edges_mm : numpy.ndarray
            (k,) int64 and (k + 1,) float64, as ``numpy.histogram`` has them; points beyond either end are in the last class there.
        """
    @property
    def mean_mm(self, /) -> float:
        """
        Mean of the distances, mm.
        """
    @property
    def overlap(self, /) -> float | None:
        """
        Share of the points that lie on the reference after alignment; None without.
        """
    @property
    def quantiles_mm(self, /) -> NDArray[float64]:
        """
        The values that 2.5, 25, 50, 75 and 97.5 % of them lie below, (5,) float64, mm.
        """
    @property
    def reference_from_cloud(self, /) -> NDArray[float64] | None:
        """
        Moves the cloud onto the reference: (4, 4) float64, mm; None where it was compared where it is.
        """
    @property
    def rivals(self, /) -> NDArray[float64]:
        """
        Other poses that fit as well, (k, 4, 4) float64: of a form that looks the same in several ways round.
        """
    @property
    def rms_mm(self, /) -> float:
        """
        Their root mean square, mm.
        """
    @property
    def robust_sigma_mm(self, /) -> float:
        """
        Their standard deviation as the median absolute deviation has it, mm.
        """
    @property
    def undetermined(self, /) -> list[str]:
        """
        Motions that the points do not determine, in words.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What to know before trusting the figures; each was warned of.
        """
    @property
    def within_95_mm(self, /) -> float:
        """
        The distance, on either side, that 95 % of them keep, mm.
        """
    @property
    def within_sigmas(self, /) -> tuple[float, float, float] | None:
        """
        Share of the points that lie off by no more than once, twice and three times their own sigma: about 0.68, 0.95 and 0.997 where form and
        sigmas are right. None for a cloud without sigmas.
        """

@final
class CylinderFit:
    """
    A fitted cylinder. Millimetres, in the points' frame.
    """
    def __repr__(self, /) -> str: ...
    @property
    def axis_direction(self, /) -> NDArray[float64]:
        """
        Unit vector along the axis, (3,) float64, its largest component positive.
        """
    @property
    def axis_point_mm(self, /) -> NDArray[float64]:
        """
        The axis's point at the middle of the points, (3,) float64, mm.
        """
    @property
    def covariance(self, /) -> NDArray[float64]:
        """
        Covariance of the parameters from the points alone, float64.
        """
    @property
    def covariance_total(self, /) -> NDArray[float64] | None:
        """
        Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
        """
    def deviations_mm(self, /, points_mm: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).

        Parameters
        ----------
        points_mm : array_like
            (n, 3), mm, in the frame of the fitted points.

        Returns
        -------
        numpy.ndarray
            (n,) float64, mm.
        """
    @property
    def extent_mm(self, /) -> tuple[float, float]:
        """
        From where to where along the axis the points lie, mm from its point.
        """
    @property
    def kind(self, /) -> str:
        """
        ``"cylinder"``
        """
    @property
    def max_inside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the inside, mm.
        """
    @property
    def max_outside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
        """
    @property
    def outliers(self, /) -> int:
        """
        Points rejected: farther off than their sigma and the number of points explain.
        """
    @property
    def point_index(self, /) -> NDArray[int64] | None:
        """
        Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
        """
    @property
    def points(self, /) -> int:
        """
        Points that the shape was fitted to.
        """
    @property
    def radius_mm(self, /) -> float:
        """
        Radius, mm.
        """
    @property
    def rms_mm(self, /) -> float:
        """
        Root mean square of the fitted points' orthogonal distances, mm.
        """
    @property
    def sigma_axis_point_mm(self, /) -> NDArray[float64]:
        """
        Standard deviations of the axis's point, (3,) float64, mm.
        """
    @property
    def sigma_direction_rad(self, /) -> float:
        """
        Standard deviation of the axis's direction in its least certain direction, rad.
        """
    @property
    def sigma_radius_mm(self, /) -> float:
        """
        Standard deviation of the radius, mm; 0 where it was given.
        """
    @property
    def sigma_total_radius_mm(self, /) -> float | None:
        """
        Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        """
    @property
    def statistics(self, /) -> dict[str, typing.Any]:
        """
        All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
        """

@final
class Fan:
    """
    The laser's fan as the mirror shows it at the reference voltage: a plane of rays from a virtual apex, in the galvanometer frame.

    Parameters
    ----------
    apex_mm : array_like
        Virtual apex, (3,), mm: x along the axis, y how far the plane misses the axis, −z the length from apex to axis.
    tilt_rad : float, default 0
        Angle between the fan's plane and the axis.
    mirror_offset_mm : float, default 0
        Mirror surface to axis, mm.
    mirror_normal_rad : float, default 0
        Direction of the mirror's normal at the reference voltage: angle from z towards y.
    """
    def __new__(cls, /, apex_mm: numpy.typing.ArrayLike, *, tilt_rad: SupportsFloat | SupportsIndex = 0.0, mirror_offset_mm: SupportsFloat | SupportsIndex = 0.0, mirror_normal_rad: SupportsFloat | SupportsIndex = 0.0) -> Fan: ...
    @property
    def apex_mm(self, /) -> NDArray[float64]:
        """
        Virtual apex, (3,) float64, mm, galvanometer frame.
        """
    @property
    def mirror_normal_rad(self, /) -> float:
        """
        Direction of the mirror's normal at the reference voltage, rad: angle from z towards y.
        """
    @property
    def mirror_offset_mm(self, /) -> float:
        """
        Mirror surface to axis, mm.
        """
    @property
    def tilt_rad(self, /) -> float:
        """
        Angle between the fan's plane and the axis, rad.
        """

@final
class Frame:
    """
    One image of a capture, with what was recorded beside it.
    """
    def __repr__(self, /) -> str: ...
    @property
    def file(self, /) -> str:
        """
        Path of the image as frames.csv gives it.
        """
    @property
    def image(self, /) -> NDArray[uint8] | NDArray[uint16]:
        """
        The grey image, (h, w), uint8 or uint16: decoded at the first look, on the thread that looks. Of a colour image it is the channel
        nearest the laser's wavelength, and the luma where the laser is off.
        """
    @property
    def index(self, /) -> int:
        """
        Number of the image, from 0: the `frame_index` of a point.
        """
    @property
    def laser_on(self, /) -> bool:
        """
        Whether the laser was on.
        """
    @property
    def pose(self, /) -> int | None:
        """
        Which placement of the target the image shows; None in a scan.
        """
    @property
    def stamp_ns(self, /) -> int:
        """
        Start of the exposure, nanoseconds since the Unix epoch.
        """
    @property
    def voltage_v(self, /) -> float | None:
        """
        The galvanometer's voltage; None where the laser is off.
        """

@final
class Frames:
    """
    The frames of a capture, one after the other.
    """
    def __iter__(self, /) -> Frames: ...
    def __next__(self, /) -> Frame: ...

@final
class Galvo:
    """
    The galvanometer: its frame in the camera's, and how far the mirror turns per volt.

    Parameters
    ----------
    camera_from_galvo : array_like
        The frame, (4, 4), mm: x along the mirror's axis, z out to the scene in the laser's plane at the reference voltage.
    degrees_per_volt : float
        Mechanical; the beam turns by twice as much.
    reference_v : float, default 0
        The voltage that fixes the frame.
    quadratic_deg_per_v2, cubic_deg_per_v3 : float, default 0
        Terms about 0 V.

    Raises
    ------
    InputError
        For a matrix that does not turn and move.
    """
    def __new__(cls, /, camera_from_galvo: numpy.typing.ArrayLike, degrees_per_volt: SupportsFloat | SupportsIndex, *, reference_v: SupportsFloat | SupportsIndex = 0.0, quadratic_deg_per_v2: SupportsFloat | SupportsIndex = 0.0, cubic_deg_per_v3: SupportsFloat | SupportsIndex = 0.0) -> Galvo: ...
    @property
    def camera_from_galvo(self, /) -> NDArray[float64]:
        """
        The frame, (4, 4) float64, mm.
        """
    @property
    def degrees_per_volt(self, /) -> float:
        """
        Mechanical turn of the mirror per volt about 0 V, degrees.
        """
    def mirror_angle_rad(self, /, voltage_v: SupportsFloat | SupportsIndex) -> float:
        """
        Mechanical angle of the mirror at `voltage_v`, rad, from where it stands at the reference voltage.
        """
    @property
    def reference_v(self, /) -> float:
        """
        The voltage that fixes the frame.
        """

@final
class Merged:
    """
    Sweeps brought together. Made by ``uwscan.merge``.
    """
    def __repr__(self, /) -> str: ...
    @property
    def cloud(self, /) -> Cloud:
        """
        All points, in the frame of the first cloud: attributes that all clouds have, covariances turned along; no frames and no pixels, which
        belong to one capture.
        """
    @property
    def covariances(self, /) -> NDArray[float64]:
        """
        Covariance of each pose beside the first one's, (k, 6, 6) float64: turn about the middle of all points, rad, and shift, mm, the first
        cloud's axes. Errors that a sweep's points share are not in it.
        """
    @property
    def pairs(self, /) -> list[dict[str, typing.Any]]:
        """
        What lies on what, for every two clouds that overlap: dictionaries of points_of and surface_of (places in the list, from 0), overlap,
        rms_mm, and floor_mm: what of that the clouds' own sigmas do not tell.
        """
    @property
    def poses(self, /) -> NDArray[float64]:
        """
        Moves each cloud into the first one's frame: (k, 4, 4) float64, mm.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What to know before trusting it; each was warned of.
        """

@final
class Mesh:
    """
    Triangles on shared vertices, mm; counter-clockwise as seen from the sensor or from outside. Its arrays are read-only views of its own
    memory.

    Parameters
    ----------
    vertices_mm : array_like
        (n, 3), mm.
    triangles : array_like
        (m, 3) whole numbers: corners as places in `vertices_mm`.
    frame : str, default "camera"
        "camera" or "galvo".

    Raises
    ------
    InputError
        Where a position is not finite or a corner names no vertex.

    Examples
    --------
    >>> import uwscan
    >>> uwscan.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).area_mm2
    0.5
    """
    def __new__(cls, /, vertices_mm: numpy.typing.ArrayLike, triangles: numpy.typing.ArrayLike, *, frame: str = "camera") -> Mesh: ...
    def __repr__(self, /) -> str: ...
    @property
    def area_mm2(self, /) -> float:
        """
        Sum of the triangles' areas, mm².
        """
    @property
    def frame(self, /) -> str:
        """
        Frame of the coordinates: ``"camera"`` or ``"galvo"``.
        """
    @property
    def intensity(self, /) -> NDArray[float32] | None:
        """
        Brightness of the stripe at the vertices, (n,) float32, DN; None where it is not known.
        """
    @staticmethod
    def load(path: str | PathLike[str]) -> Mesh:
        """
        The mesh of a file: .ply, .stl or .obj.

        Raises
        ------
        FileError, FormatError
            Where the file can't be read, or holds what no mesh holds.
        """
    @property
    def normals(self, /) -> NDArray[float32] | None:
        """
        Unit normals of the vertices, (n, 3) float32; None where there are none.
        """
    @property
    def point_index(self, /) -> NDArray[uint32] | None:
        """
        Which point of the cloud each vertex is, (n,) uint32; None for a mesh that was not triangulated from a cloud.
        """
    def save(self, /, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """
        Writes the mesh, whole or not at all: .ply or .stl (binary), .obj, or .glb (in metres).

        Raises
        ------
        ExistingFileError
            Where the file exists, unless `overwrite` is true.
        FormatError
            For a name with another ending.
        """
    @property
    def sigma_mm(self, /) -> NDArray[float32] | None:
        """
        Standard deviation of the vertices along their least certain direction, (n,) float32, mm; None where it is not known.
        """
    @property
    def triangles(self, /) -> NDArray[uint32]:
        """
        Corners as places in `vertices_mm`, (m, 3) uint32.
        """
    @property
    def vertices_mm(self, /) -> NDArray[float64]:
        """
        Positions, (n, 3) float64, mm.
        """

@final
class NoiseModel:
    """
    Noise of a grey value μ that holds a stripe's signal s: variance
    ``read_noise_dn² + 1/12 + μ / gain_e_per_dn + (speckle_contrast · s)²``, DN².

    Parameters
    ----------
    gain_e_per_dn : float
        Electrons a DN.
    read_noise_dn : float
        Standard deviation in the dark, without rounding, DN.
    speckle_contrast : float, default 0
        Standard deviation over mean of the laser's speckle, per pixel.
    full_scale_dn : float, default 255
        Grey value at and above which pixels are clipped, DN.

    Raises
    ------
    InputError
        For a value that is not finite or out of range.

    Examples
    --------
    >>> import uwscan
    >>> noise = uwscan.NoiseModel(40.0, 1.0)
    >>> round(noise.variance_dn2(100.0), 4)
    3.5833
    """
    def __eq__(self, value: object, /) -> bool: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __new__(cls, /, gain_e_per_dn: SupportsFloat | SupportsIndex, read_noise_dn: SupportsFloat | SupportsIndex, speckle_contrast: SupportsFloat | SupportsIndex = 0.0, full_scale_dn: SupportsFloat | SupportsIndex = 255.0) -> NoiseModel: ...
    def __repr__(self, /) -> str: ...
    @staticmethod
    def from_flat_fields(images: typing.Any, *, full_scale_dn: SupportsFloat | SupportsIndex | None = None) -> NoiseModel:
        """
        The camera's noise from frames of even light and of none: photon transfer.

        Parameters
        ----------
        images : sequence of numpy.ndarray
            One stack (n, h, w) an exposure, n ≥ 2, uint8 or uint16, taken one after the other of the same light or of none; levels
            should reach from the dark to near full scale. A single stack is one exposure, of which vignetting makes many levels.
        full_scale_dn : float, optional
            Where pixels are clipped, for example 4095 for 12 bits; by default 255, and 65535 for uint16.

        Returns
        -------
        NoiseModel
            With `sigma_gain_e_per_dn` and `sigma_read_noise_dn`.

        Raises
        ------
        InputError
            Where the frames do not tell the gain.
        """
    @property
    def full_scale_dn(self, /) -> float:
        """
        Grey value at and above which pixels are clipped, DN.
        """
    @property
    def gain_e_per_dn(self, /) -> float:
        """
        Electrons a DN.
        """
    @property
    def read_noise_dn(self, /) -> float:
        """
        Standard deviation in the dark, without rounding, DN.
        """
    @property
    def sigma_gain_e_per_dn(self, /) -> float | None:
        """
        Standard deviation of the gain, e⁻/DN; None unless it was estimated from flat fields.
        """
    @property
    def sigma_read_noise_dn(self, /) -> float | None:
        """
        Standard deviation of the read noise, DN; None unless it was estimated from flat fields.
        """
    @property
    def speckle_contrast(self, /) -> float:
        """
        Standard deviation over mean of the laser's speckle, per pixel.
        """
    def variance_dn2(self, /, level_dn: SupportsFloat | SupportsIndex, signal_dn: SupportsFloat | SupportsIndex = 0.0) -> float:
        """
        Variance, DN², of a pixel whose expected grey value is `level_dn`, `signal_dn` of it the stripe's.
        """

@final
class PlaneFit:
    """
    A fitted plane n·p + offset = 0, |n| = 1. Millimetres, in the points' frame.
    """
    def __repr__(self, /) -> str: ...
    @property
    def covariance(self, /) -> NDArray[float64]:
        """
        Covariance of the parameters from the points alone, float64.
        """
    @property
    def covariance_total(self, /) -> NDArray[float64] | None:
        """
        Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
        """
    def deviations_mm(self, /, points_mm: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).

        Parameters
        ----------
        points_mm : array_like
            (n, 3), mm, in the frame of the fitted points.

        Returns
        -------
        numpy.ndarray
            (n,) float64, mm.
        """
    @property
    def kind(self, /) -> str:
        """
        ``"plane"``
        """
    @property
    def max_inside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the inside, mm.
        """
    @property
    def max_outside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
        """
    @property
    def normal(self, /) -> NDArray[float64]:
        """
        Unit normal towards the sensor, (3,) float64.
        """
    @property
    def offset_mm(self, /) -> float:
        """
        d in n·p + d = 0, mm.
        """
    @property
    def outliers(self, /) -> int:
        """
        Points rejected: farther off than their sigma and the number of points explain.
        """
    @property
    def point_index(self, /) -> NDArray[int64] | None:
        """
        Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
        """
    @property
    def points(self, /) -> int:
        """
        Points that the shape was fitted to.
        """
    @property
    def rms_mm(self, /) -> float:
        """
        Root mean square of the fitted points' orthogonal distances, mm.
        """
    @property
    def sigma_normal_rad(self, /) -> float:
        """
        Standard deviation of the normal in its least certain direction, rad.
        """
    @property
    def sigma_offset_mm(self, /) -> float:
        """
        Standard deviation of the offset, mm.
        """
    @property
    def sigma_total_offset_mm(self, /) -> float | None:
        """
        Standard deviation of the offset with the calibration's part, mm; None where no calibration was given.
        """
    @property
    def statistics(self, /) -> dict[str, typing.Any]:
        """
        All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
        """

@final
class Port:
    """
    A flat glass window between air inside and a medium outside. Lengths are along its normal, from the centre of projection behind it.

    Parameters
    ----------
    normal : array_like
        Unit normal outwards, (3,), camera frame.
    distance_mm : float
        Centre of projection to the inner face, mm.
    thickness_mm : float
        Thickness of the glass, mm.
    index : float
        Index of refraction of the glass, relative to air.

    Raises
    ------
    GeometryError
        For a normal that is not of length 1, a negative length, an index below 1.

    Examples
    --------
    >>> import uwscan
    >>> port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
    >>> origins, directions = port.back_project([[0.0, 0.0, 1.0]], index=1.335)
    >>> origins.tolist(), directions.tolist()
    ([[0.0, 0.0, 18.0]], [[0.0, 0.0, 1.0]])
    """
    def __new__(cls, /, normal: numpy.typing.ArrayLike, distance_mm: SupportsFloat | SupportsIndex, thickness_mm: SupportsFloat | SupportsIndex, index: SupportsFloat | SupportsIndex) -> Port: ...
    def __repr__(self, /) -> str: ...
    def back_project(self, /, directions: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
        """
        Rays outside that leave the centre of projection with directions in air.

        Parameters
        ----------
        directions : array_like
            (n, 3), any length.
        index : float
            Index of refraction outside, relative to air.

        Returns
        -------
        origins_mm, directions : numpy.ndarray
            (n, 3) float64 each: points on the outer face, mm, and unit directions; NaN where no ray gets out.
        """
    @property
    def distance_mm(self, /) -> float:
        """
        Centre of projection to the inner face, mm.
        """
    @property
    def index(self, /) -> float:
        """
        Index of refraction of the glass, relative to air.
        """
    @property
    def normal(self, /) -> NDArray[float64]:
        """
        Unit normal outwards, (3,) float64, camera frame.
        """
    def project(self, /, points_mm: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        Directions in air in which light leaves the centre of projection to reach points outside: exact through both faces.

        Parameters
        ----------
        points_mm : array_like
            (n, 3), mm, from the centre of projection.
        index : float
            Index of refraction outside, relative to air.

        Returns
        -------
        numpy.ndarray
            (n, 3) float64, not of length 1; NaN for points that are not outside the window.
        """
    @property
    def thickness_mm(self, /) -> float:
        """
        Thickness of the glass, mm.
        """

@final
class ResidualTable:
    """
    Residuals of corners, or of stripe points, a row each. Arrays are read-only views of its own memory.
    """
    def __len__(self, /) -> int: ...
    def __repr__(self, /) -> str: ...
    @property
    def frame(self, /) -> NDArray[uint32]:
        """
        Image, (n,) uint32: a place in ``Residuals.files``.
        """
    @property
    def off_sheet_mm(self, /) -> NDArray[float64] | None:
        """
        Distance of the board's point from the sheet of light, (n,) float64, mm; None of corners.
        """
    @property
    def pixel(self, /) -> NDArray[float64]:
        """
        Where it was seen, (n, 2) float64, px; (0, 0) is the centre of the top-left pixel.
        """
    @property
    def point(self, /) -> NDArray[uint32]:
        """
        Number of the corner in its image, or line (row or column) of the stripe point, (n,) uint32.
        """
    @property
    def pose(self, /) -> NDArray[uint32]:
        """
        Placement of the board, (n,) uint32.
        """
    @property
    def residual_px(self, /) -> NDArray[float64]:
        """
        Model less measurement, px: (n, 2) float64 of corners, (n,) of stripes, along the measured coordinate.
        """
    @property
    def standardised(self, /) -> NDArray[float64]:
        """
        The same in standard deviations, as measurements were weighted, the shape of `residual_px`; a corner's two along axes that make its errors
        independent. Of unit variance where the predicted sigmas and their common scale are right.
        """
    @property
    def used(self, /) -> NDArray[bool_]:
        """
        Whether it took part, (n,) bool: false for what was sorted out as an outlier or not to be trusted.
        """
    @property
    def voltage_v(self, /) -> NDArray[float64] | None:
        """
        The galvanometer's voltage, (n,) float64, V; None of corners.
        """

@final
class Residuals:
    """
    The residuals of a calibration: model less measurement, of every corner and every stripe point, those that were left out, too.

    Placements of the board and images are numbered from 0 in the order in which they were captured: ``corners.pose`` and ``stripes.pose`` are
    places in `pose_medium` and `camera_from_board`, ``frame`` in `files`.
    """
    def __repr__(self, /) -> str: ...
    @property
    def camera_from_board(self, /) -> NDArray[float64]:
        """
        Where the board was found to be at each placement: (p, 4, 4) float64, mm.
        """
    @property
    def corners(self, /) -> ResidualTable:
        """
        The board's corners: two residuals each, u and v.
        """
    @property
    def files(self, /) -> list[str]:
        """
        Names of the images.
        """
    @property
    def pose_medium(self, /) -> list[str]:
        """
        What was outside the windows at each placement: ``"air"`` or ``"water"``.
        """
    @property
    def stripes(self, /) -> ResidualTable:
        """
        The stripes' points on the board: one residual each, along the measured coordinate.
        """

@final
class Scanner:
    """
    The whole instrument: camera, galvanometer and laser, each behind its window. Camera frame, millimetres; exact at both windows.

    Parameters
    ----------
    camera : Camera
    camera_port : Port
        Seen from the optical centre.
    galvo : Galvo
    fan : Fan
    laser_port : Port
        Seen from the galvanometer frame's origin; its normal in the camera frame.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> camera = uwscan.Camera([[1400, 0, 384], [0, 1400, 288], [0, 0, 1]])
    >>> port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
    >>> frame = np.array([[0, 0.9002, -0.4355, 430], [-1, 0, 0, 0], [0, 0.4355, 0.9002, -13], [0, 0, 0, 1.0]])
    >>> frame[:3, :3] = np.linalg.qr(frame[:3, :3])[0] * [-1, 1, 1]
    >>> frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
    >>> galvo = uwscan.Galvo(frame, 2.0)
    >>> scanner = uwscan.Scanner(camera, port, galvo, uwscan.Fan([0, 0, -90]), port)
    >>> pixels = scanner.project([[10.0, 20.0, 800.0]], index=1.335)
    >>> origins, directions = scanner.back_project(pixels, index=1.335)
    >>> bool(np.linalg.norm(np.cross([10.0, 20.0, 800.0] - origins, directions)) < 1e-9)
    True
    """
    def __new__(cls, /, camera: Camera, camera_port: Port, galvo: Galvo, fan: Fan, laser_port: Port) -> Scanner: ...
    def __repr__(self, /) -> str: ...
    def back_project(self, /, pixels: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
        """
        Rays outside the window that the camera sees at pixels.

        Parameters
        ----------
        pixels : array_like
            (u, v), (n, 2), px.
        index : float
            Index of refraction outside, relative to air.

        Returns
        -------
        origins_mm, directions : numpy.ndarray
            (n, 3) float64 each, camera frame: points on the window's outer face, mm, and unit directions; NaN where there is no ray.
        """
    @property
    def camera(self, /) -> Camera:
        """
        The camera in air.
        """
    @property
    def camera_port(self, /) -> Port:
        """
        The camera's window, seen from the optical centre.
        """
    @property
    def fan(self, /) -> Fan:
        """
        The laser's fan, galvanometer frame.
        """
    @property
    def galvo(self, /) -> Galvo:
        """
        The galvanometer.
        """
    @property
    def laser_port(self, /) -> Port:
        """
        The laser's window, seen from the galvanometer frame's origin; normal in the camera frame.
        """
    def off_sheet(self, /, points_mm: numpy.typing.ArrayLike, voltage_v: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        Sine of the angle between the laser's sheet and the light to points: zero on the sheet.

        Parameters
        ----------
        points_mm : array_like
            (n, 3), camera frame, mm.
        voltage_v : array_like
            The galvanometer's voltage, (n,) or one for all.
        index : float
            Index of refraction outside, relative to air.

        Returns
        -------
        numpy.ndarray
            (n,) float64; NaN for points that are not outside the laser's window.
        """
    def project(self, /, points_mm: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        Pixels at which the camera sees points outside its window.

        Parameters
        ----------
        points_mm : array_like
            (n, 3), camera frame, mm.
        index : float
            Index of refraction outside, relative to air (``uwscan.water_index``; 1 on land).

        Returns
        -------
        numpy.ndarray
            (u, v), (n, 2) float64, px; NaN for points that it sees nowhere.
        """
    def triangulate(self, /, pixels: numpy.typing.ArrayLike, voltage_v: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        Points of the laser's sheet that are seen at pixels.

        Parameters
        ----------
        pixels : array_like
            (u, v), (n, 2), px.
        voltage_v : array_like
            The galvanometer's voltage, (n,) or one for all.
        index : float
            Index of refraction outside, relative to air.

        Returns
        -------
        numpy.ndarray
            (n, 3) float64, camera frame, mm; NaN where a pixel's ray does not meet the sheet.
        """
    def triangulate_with_derivatives(self, /, pixels: numpy.typing.ArrayLike, voltage_v: numpy.typing.ArrayLike, *, index: SupportsFloat | SupportsIndex) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
        """
        Points of the laser's sheet that are seen at pixels, with their derivatives: what a pixel's or a voltage's error makes of them.

        Parameters
        ----------
        pixels, voltage_v, index
            As ``triangulate`` has them.

        Returns
        -------
        points_mm, per_u, per_v, per_volt : numpy.ndarray
            (n, 3) float64 each, camera frame: mm, mm/px, mm/px, mm/V; NaN where a pixel's ray does not meet the sheet.
        """

@final
class Shapes:
    """
    The shapes of a cloud, the one with the most points first: a sequence of SphereFit, PlaneFit and CylinderFit.
    """
    def __getitem__(self, index: SupportsIndex, /) -> SphereFit | PlaneFit | CylinderFit: ...
    def __iter__(self, /) -> Iterator[SphereFit | PlaneFit | CylinderFit]: ...
    def __len__(self, /) -> int: ...
    def __repr__(self, /) -> str: ...
    @property
    def angles_rad(self, /) -> list[tuple[int, int, float, float, float | None]]:
        """
        Angles between planes and axes as (a, b, angle_rad, sigma_rad, sigma_total_rad).
        """
    @property
    def distances_mm(self, /) -> list[tuple[int, int, float, float, float | None]]:
        """
        Distances between shapes as (a, b, distance_mm, sigma_mm, sigma_total_mm): places in the sequence, mm; the last is None where no
        calibration was given.
        """
    @property
    def unassigned_points(self, /) -> int:
        """
        Points that no shape holds.
        """

@final
class SphereFit:
    """
    A fitted sphere. Millimetres, in the points' frame.
    """
    def __repr__(self, /) -> str: ...
    @property
    def center_mm(self, /) -> NDArray[float64]:
        """
        Centre, (3,) float64, mm.
        """
    @property
    def covariance(self, /) -> NDArray[float64]:
        """
        Covariance of the parameters from the points alone, float64.
        """
    @property
    def covariance_total(self, /) -> NDArray[float64] | None:
        """
        Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
        """
    def deviations_mm(self, /, points_mm: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).

        Parameters
        ----------
        points_mm : array_like
            (n, 3), mm, in the frame of the fitted points.

        Returns
        -------
        numpy.ndarray
            (n,) float64, mm.
        """
    @property
    def kind(self, /) -> str:
        """
        ``"sphere"``
        """
    @property
    def max_inside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the inside, mm.
        """
    @property
    def max_outside_mm(self, /) -> float:
        """
        Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
        """
    @property
    def outliers(self, /) -> int:
        """
        Points rejected: farther off than their sigma and the number of points explain.
        """
    @property
    def point_index(self, /) -> NDArray[int64] | None:
        """
        Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
        """
    @property
    def points(self, /) -> int:
        """
        Points that the shape was fitted to.
        """
    @property
    def radius_mm(self, /) -> float:
        """
        Radius, mm.
        """
    @property
    def rms_mm(self, /) -> float:
        """
        Root mean square of the fitted points' orthogonal distances, mm.
        """
    @property
    def sigma_center_mm(self, /) -> NDArray[float64]:
        """
        Standard deviations of the centre from the points alone, (3,) float64, mm.
        """
    @property
    def sigma_radius_mm(self, /) -> float:
        """
        Standard deviation of the radius from the points alone, mm; 0 where it was given.
        """
    @property
    def sigma_total_center_mm(self, /) -> NDArray[float64] | None:
        """
        Standard deviations of the centre with the calibration's part, (3,) float64, mm; None where no calibration was given.
        """
    @property
    def sigma_total_radius_mm(self, /) -> float | None:
        """
        Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        """
    @property
    def statistics(self, /) -> dict[str, typing.Any]:
        """
        All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
        """

@final
class Stripe:
    """
    The laser stripe of an image or of a stack of images: one entry a line (row or column) of the whole image.

    Arrays have the shape (h,) for an image and (n, h) for a stack (with ``axis="columns"``: w instead of h). They are views of
    one block of memory, which ``extract_stripe(…, out=stripe)`` fills anew.
    """
    def __repr__(self, /) -> str: ...
    @property
    def amplitude(self, /) -> NDArray[float32]:
        """
        Peak height above the background, DN. float32.
        """
    @property
    def axis(self, /) -> str:
        """
        ``"rows"``: one measurement a row, the position is u; ``"columns"``: one a column, the position is v.
        """
    @property
    def background(self, /) -> NDArray[float32]:
        """
        Background under the centre, DN. float32.
        """
    @property
    def chi2(self, /) -> NDArray[float32]:
        """
        Chi-square of the fit by its degrees of freedom; NaN where it is not measured. float32.
        """
    @property
    def flags(self, /) -> NDArray[uint16]:
        """
        What is noteworthy about each measurement: bits of ``uwscan.StripeFlags``. uint16.
        """
    @property
    def position_px(self, /) -> NDArray[float32]:
        """
        Centre along the line, px; 0 is the centre of the line's first pixel. NaN where there is no stripe. float32.
        """
    @property
    def reject(self, /) -> NDArray[uint16]:
        """
        Why a line has no position: a value of ``uwscan.StripeReject``; 0 where it has one. uint16.
        """
    @property
    def rival_ratio(self, /) -> NDArray[float32]:
        """
        Strength of the strongest other peak of the line by that of the one taken; 0: no other; NaN: not looked for. float32.
        """
    @property
    def shape(self, /) -> list[int]:
        """
        Number of images and of lines: (h,) or (n, h).
        """
    @property
    def sigma_px(self, /) -> NDArray[float32]:
        """
        Predicted standard deviation of the position, px. float32.
        """
    @property
    def width_px(self, /) -> NDArray[float32]:
        """
        Standard deviation of the Gaussian cross section along the line, px. float32.
        """

def average(cloud: Cloud | numpy.typing.ArrayLike, *, spacing_mm: SupportsFloat | SupportsIndex) -> Cloud:
    """
    The cloud with the points of each cube made one, at their mean.

    Covariances are those of the means: points of one image are neighbours on a stripe, and no number of them is better than their mean
    covariance; those of different images err each on its own, but for what all points share. What points scatter by beyond that is added along their normal.

    Parameters
    ----------
    cloud : Cloud or array_like
        Points, (n, 3), mm.
    spacing_mm : float
        Edge of the cubes, mm.

    Returns
    -------
    Cloud
        Intensities are means, frames and pixels those of the point nearest to the middle; normals and deviations are left out.

    Raises
    ------
    InputError
        For a length that is not from 1e-6 to 1e6; for positions that are not finite.

    Examples
    --------
    >>> import uwscan
    >>> uwscan.average([[0, 0, 700], [0.2, 0, 700.1], [30, 0, 700]], spacing_mm=1.0).points_mm.tolist()
    [[0.1, 0.0, 700.05], [30.0, 0.0, 700.0]]
    """

def batch_fail(name: str, path: str | os.PathLike[str], output: str | os.PathLike[str], message: str) -> dict[str, typing.Any]:
    """
    Records that a recording failed for a reason from outside; gives its row of the table.
    """

def batch_jobs(folder: str | PathLike[str]) -> list[tuple[str, Path]]:
    """
    The recordings under a folder as (name, path), in the order of their names.
    """

def batch_one(name: str, path: str | os.PathLike[str], calibration: str | os.PathLike[str], output: str | os.PathLike[str], *, refraction: str = "exact", frame: str = "camera", stripe: str = "robust", medium: str | None = None, water_index: SupportsFloat | SupportsIndex | None = None, water: tuple[SupportsFloat | SupportsIndex, SupportsFloat | SupportsIndex, SupportsFloat | SupportsIndex] | None = None, threads: SupportsIndex = 1) -> dict[str, typing.Any]:
    """
    Makes one recording's cloud and its result, unless both are there; gives its row of the table.
    """

def batch_table(jobs: collections.abc.Sequence[tuple[str, str | os.PathLike[str]]], output: str | os.PathLike[str]) -> pathlib.Path:
    """
    Writes the table of the recordings' results (CSV), from the files beside their clouds; where it is.
    """

def calibrate(captures: Capture | str | os.PathLike[str] | collections.abc.Sequence[Capture | str | os.PathLike[str]], *, rig: str | os.PathLike[str] | None = None, method: typing.Literal['joint', 'paper'] = "joint", report: str | os.PathLike[str] | None = None, made: str | None = None, overwrite: bool = False, threads: SupportsIndex | None = None, progress: collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None = None) -> Calibration:
    """
    The calibration from captures of a chessboard, in air, in water or both: one joint adjustment of the whole instrument.

    Parameters
    ----------
    captures : Capture, path, or sequence of them
        Captures of kind "calibration".
    rig : str or os.PathLike, optional
        A rig file that replaces the captures' own.
    method : str, default "joint"
        "joint", or "paper" for the paper's method (on land, windows neglected until reconstruction).
    report : str or os.PathLike, optional
        Write a page (.html), too: residual maps, coverage of the view, placements, correlations, rejected images, advice.
    made : str, optional
        When the page was made, as it is to say it.
    overwrite : bool, default False
        Replace the page where it exists.
    threads : int, optional
        Threads to work on; one a processor by default. The result does not depend on it.
    progress : callable, optional
        Told of progress as ``progress(stage, done, total)``; False tells nobody. In a notebook with tqdm a bar is shown by itself.

    Returns
    -------
    Calibration
        With ``residuals``, by the joint method.

    Raises
    ------
    CalibrationError
        Where the captures determine no calibration; it says what to capture.
    CaptureError, FileError, FormatError
        Where a capture is of the wrong kind, shows no board, or a file is wrong.
    ExistingFileError, InputError
        Where the page exists, or its name is no page's: before anything is calibrated.
    KeyboardInterrupt
        On Ctrl-C; nothing was changed.
    """

def calibrate_camera(capture: Capture | str | os.PathLike[str], *, equal_focal: bool = False, k3: bool = True, threads: SupportsIndex | None = None, progress: collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None = None) -> CameraFit:
    """
    A camera alone, from photographs of a chessboard on land: a pinhole with Brown-Conrady distortion, as OpenCV's ``calibrateCamera`` has it. For a
    camera without a window, or to compare with other programs; the whole instrument, under water too, is ``uwscan.calibrate``'s.

    Parameters
    ----------
    capture : Capture or path
        A capture of kind "calibration", in air; its images without the laser are looked at. It needs no rig.toml.
    equal_focal : bool, default False
        The pixels are square: fx = fy.
    k3 : bool, default True
        Whether k3 is estimated; else it is 0.
    threads : int, optional
        Threads to work on; one a processor by default. The result does not depend on it.
    progress : callable, optional
        As ``uwscan.calibrate`` has it.

    Returns
    -------
    CameraFit

    Raises
    ------
    CalibrationError
        Where the images determine no camera; it says what is missing.
    CaptureError, FileError, FormatError
        Where the capture is no calibration's in air, shows no board, or a file is wrong.

    Examples
    --------
    >>> import uwscan
    >>> fit = uwscan.calibrate_camera("fixtures/photographs", equal_focal=True)
    >>> len(fit.files), bool(abs(fit.camera_matrix[0, 0] - 533.5) < 2.0)
    (13, True)
    """

def compare(points: Cloud | Mesh | numpy.typing.ArrayLike, reference: Mesh | str | os.PathLike[str], *, align: bool = True, near_mm: SupportsFloat | SupportsIndex | None = None, least_overlap: SupportsFloat | SupportsIndex = 0.2) -> Comparison:
    """
    How far a cloud or mesh lies off a reference mesh, after best-fit alignment from anywhere.

    Distances are those to the nearest point of the reference's triangles, with the sign of the side that they face. Points whose nearest
    point lies on a border of an open reference are beyond it, and have no distance. Alignment takes every error of form along that a rigid
    motion can: what is left is the best fit's, not a datum's.

    Parameters
    ----------
    points : Cloud, Mesh or array_like
        What was measured: points, (n, 3), mm, or a mesh's vertices. A cloud brings its covariances along.
    reference : Mesh, str or os.PathLike
        What it should be, mm.
    align : bool, default True
        False: compare it where it is.
    near_mm : float, optional
        Where it is already right to within this distance, mm: look no farther.
    least_overlap : float, default 0.2
        Share of the points that must come to lie on the reference.

    Returns
    -------
    Comparison

    Raises
    ------
    AlignmentError
        For a reference without area, points that do not come to lie on it, and where none lies beside it.
    InputError
        For a setting out of range.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> plate = uwscan.Mesh([[0, 0, 0], [40, 0, 0], [0, 40, 0], [40, 40, 0]], [[0, 1, 2], [1, 3, 2]])
    >>> x, y = np.meshgrid(np.arange(5.0, 35), np.arange(5.0, 35))
    >>> measured = np.stack([x, y, np.full_like(x, 0.25)], axis=-1).reshape(-1, 3)
    >>> import warnings; warnings.simplefilter("ignore", uwscan.UwscanWarning)
    >>> round(uwscan.compare(measured, plate, align=False).mean_mm, 6)
    0.25
    """

def estimate_normals(cloud: Cloud | numpy.typing.ArrayLike, *, neighbours: SupportsIndex = ..., sensor_mm: numpy.typing.ArrayLike | None = None) -> Cloud:
    """
    The cloud with the surface's unit normal at each point, towards the sensor, from the plane through its neighbours.

    Parameters
    ----------
    cloud : Cloud or array_like
        Points, (n, 3), mm.
    neighbours : int, default 24
        Points that a plane is laid through, 4 to 1000; four times as many are asked where these lie on one line.
    sensor_mm : array_like, optional
        The sensor's place in the points' frame, (3,), mm; the origin by default.

    Returns
    -------
    Cloud
        With ``normals``; (0, 0, 0) where the neighbours tell no plane.

    Raises
    ------
    InputError
        For positions that are not finite, or a number of neighbours out of range.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    >>> cloud = uwscan.estimate_normals(np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3))
    >>> bool(np.all(np.abs(cloud.normals - [0, 0, -1]) < 1e-6))
    True
    """

def extract_stripe(image: numpy.typing.NDArray[numpy.uint8] | numpy.typing.NDArray[numpy.uint16], *, axis: typing.Literal['rows', 'columns'] = "rows", method: typing.Literal['fast', 'robust', 'precise', 'ridge', 'cog', 'blais-rioux'] = "robust", noise: NoiseModel | None = None, sigma_px: SupportsFloat | SupportsIndex | None = None, threshold: SupportsFloat | SupportsIndex | None = None, roi: tuple[SupportsIndex, SupportsIndex, SupportsIndex, SupportsIndex] | None = None, background: numpy.typing.NDArray[numpy.uint8] | numpy.typing.NDArray[numpy.uint16] | None = None, reject_edges: bool = False, full_scale_dn: SupportsFloat | SupportsIndex | None = None, out: Stripe | None = None, threads: SupportsIndex = 1) -> Stripe:
    """
    The laser stripe of an image, or of each image of a stack, to a fraction of a pixel.

    Parameters
    ----------
    image : numpy.ndarray
        (h, w) or (n, h, w), uint8 or uint16 (right-justified). Read as it lies in memory where the pixels of a row follow each other.
    axis : str, default "rows"
        "rows": one measurement a row (a stripe roughly vertical); "columns": one a column.
    method : str, default "robust"
        "fast", "robust", "precise", "ridge", "cog" or "blais-rioux".
    noise : NoiseModel, optional
        The camera's noise. Without it the noise is read off the image: by "precise" off each, by the others off the first image of the
        stack that shows enough of a stripe.
    sigma_px : float, optional
        Standard deviation of the stripe's cross section, px. Without it, as `noise`.
    threshold : float, optional
        Least ratio of the stripe's light to its sigma; 5 by default.
    roi : tuple of int, optional
        Region looked at: (x, y, width, height).
    background : numpy.ndarray, optional
        (h, w) of the image's type: the same scene with the laser off. With it, lines are measured as by "precise".
    reject_edges : bool, default False
        Leave out what lies on an edge of brightness.
    full_scale_dn : float, optional
        Value at which pixels are clipped, where `noise` does not say it; by default the least 2ⁿ − 1 that the image does not exceed.
    out : Stripe, optional
        A result of the same shape and axis to fill anew, instead of making one.
    threads : int, default 1
        Threads that share a stack.

    Returns
    -------
    Stripe
        Arrays of the shape (h,), or (n, h) for a stack.

    Raises
    ------
    DtypeError
        For an array that is not of uint8 or uint16.
    InputError
        For an image without pixels, of another shape, or a setting out of range. An image without a stripe is no error: its
        positions are NaN.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x = np.arange(40)
    >>> row = 200 * np.exp(-0.125 * (x - 20.25) ** 2)
    >>> stripe = uwscan.extract_stripe(np.tile(row, (16, 1)).astype(np.uint8))
    >>> bool(np.all(np.abs(stripe.position_px - 20.25) < 0.02))
    True
    """

def find_outliers(cloud: Cloud | numpy.typing.ArrayLike, *, limit_sigmas: SupportsFloat | SupportsIndex = 5.0) -> numpy.typing.NDArray[numpy.bool_]:
    """
    Which points are no part of a surface: those that lie apart from all others, and those of a sweep that their neighbours in line and voltage
    disagree with.

    A point lies apart where the mean distance of its twelve nearest neighbours is larger than the median of all points' by more than
    `limit_sigmas` robust standard deviations, both as logarithms. A sweep's point disagrees where it lies off the plane through those that
    hang together with it by more than `limit_sigmas` standard deviations, or hangs together with fewer than two; that needs a cloud with
    pixels, frames and sigmas, and of another only the first is asked.

    Parameters
    ----------
    cloud : Cloud or array_like
        Points, (n, 3), mm.
    limit_sigmas : float, default 5
        From 1 to 100.

    Returns
    -------
    numpy.ndarray
        (n,) bool: ``cloud.select(~found)`` is what is left.

    Raises
    ------
    InputError
        For positions that are not finite, or a limit out of range.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
    >>> points[7, 2] -= 40
    >>> np.flatnonzero(uwscan.find_outliers(points)).tolist()
    [7]
    """

def find_shapes(points: Cloud | numpy.typing.ArrayLike, *, covariance_mm2: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, max: SupportsIndex | None = None, sensor_mm: numpy.typing.ArrayLike | None = None, calibration: Calibration | str | os.PathLike[str] | None = None, index_sigma: SupportsFloat | SupportsIndex | None = None, seed: SupportsIndex = 1) -> Shapes:
    """
    The spheres, planes and cylinders of a cloud, and the distances and angles between them.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm. A cloud brings its covariances along.
    covariance_mm2, sigma_mm, calibration, index_sigma, seed
        As ``uwscan.fit_sphere`` has them.
    max : int, optional
        At most so many shapes, those with the most points.
    sensor_mm : array_like, optional
        The sensor's place in the points' frame, (3,), mm; the origin by default.

    Returns
    -------
    Shapes
        A sequence; empty where there are none.

    Raises
    ------
    FitError
        For fewer than four points, or values that are not finite.
    """

def fit_circle(points: Cloud | numpy.typing.ArrayLike, *, covariance_mm2: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, radius_mm: SupportsFloat | SupportsIndex | None = None, sensor_mm: numpy.typing.ArrayLike | None = None, calibration: Calibration | str | os.PathLike[str] | None = None, index_sigma: SupportsFloat | SupportsIndex | None = None, seed: SupportsIndex = 1) -> CircleFit:
    """
    The circle that most points lie along: a curve in space, such as an edge.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm. A cloud brings its covariances along.
    radius_mm : float, optional
        The radius where it is known.
    sensor_mm : array_like, optional
        The sensor's place in the points' frame, (3,), mm, which the normal faces; the origin by default.
    covariance_mm2, sigma_mm, calibration, index_sigma, seed
        As ``uwscan.fit_sphere`` has them.

    Returns
    -------
    CircleFit

    Raises
    ------
    FitError
        Where the points hold no circle or do not determine one, or are not finite.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> t = 0.05 * np.arange(90)
    >>> fit = uwscan.fit_circle(np.stack([25 * np.cos(t), 25 * np.sin(t), np.full(90, 700.0)], axis=1))
    >>> round(fit.radius_mm, 9)
    25.0
    """

def fit_cylinder(points: Cloud | numpy.typing.ArrayLike, *, covariance_mm2: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, radius_mm: SupportsFloat | SupportsIndex | None = None, calibration: Calibration | str | os.PathLike[str] | None = None, index_sigma: SupportsFloat | SupportsIndex | None = None, seed: SupportsIndex = 1) -> CylinderFit:
    """
    The cylinder that most points lie on.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm. A cloud brings its covariances along.
    radius_mm : float, optional
        The radius where it is known.
    covariance_mm2, sigma_mm, calibration, index_sigma, seed
        As ``uwscan.fit_sphere`` has them.

    Returns
    -------
    CylinderFit

    Raises
    ------
    FitError
        Where the points hold no cylinder or do not determine one, or are not finite.
    """

def fit_plane(points: Cloud | numpy.typing.ArrayLike, *, covariance_mm2: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, sensor_mm: numpy.typing.ArrayLike | None = None, calibration: Calibration | str | os.PathLike[str] | None = None, index_sigma: SupportsFloat | SupportsIndex | None = None, seed: SupportsIndex = 1) -> PlaneFit:
    """
    The plane that most points lie on, its normal towards the sensor.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm. A cloud brings its covariances along.
    covariance_mm2, sigma_mm, calibration, index_sigma, seed
        As ``uwscan.fit_sphere`` has them.
    sensor_mm : array_like, optional
        The sensor's place in the points' frame, (3,), mm; the origin by default.

    Returns
    -------
    PlaneFit

    Raises
    ------
    FitError
        Where the points hold no plane, lie on a line, or are not finite.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x, y = np.meshgrid(np.arange(10.0), np.arange(10.0))
    >>> fit = uwscan.fit_plane(np.stack([x, y, 700 + 0.1 * x], axis=-1).reshape(-1, 3))
    >>> bool(fit.normal[2] < 0), fit.points
    (True, 100)
    """

def fit_sphere(points: Cloud | numpy.typing.ArrayLike, *, covariance_mm2: numpy.typing.ArrayLike | None = None, sigma_mm: numpy.typing.ArrayLike | None = None, radius_mm: SupportsFloat | SupportsIndex | None = None, calibration: Calibration | str | os.PathLike[str] | None = None, index_sigma: SupportsFloat | SupportsIndex | None = None, seed: SupportsIndex = 1) -> SphereFit:
    """
    The sphere that most points lie on.

    Maximum likelihood with errors in variables after a start that stands up to seven tenths of outliers.

    Parameters
    ----------
    points : Cloud or array_like
        Points, (n, 3), mm. A cloud brings its covariances along.
    covariance_mm2 : array_like, optional
        Covariances of the points, (n, 3, 3) or (n, 6), mm², instead of the cloud's.
    sigma_mm : array_like, optional
        Standard deviation of the points in every direction, (n,) or one for all, mm, instead of covariances.
    radius_mm : float, optional
        The radius where it is known: only the centre is fitted.
    calibration : Calibration or path, optional
        What the cloud was reconstructed with: adds its part of the uncertainty, which all points share (``sigma_total_…``).
    index_sigma : float, optional
        Standard deviation of the water's index where ``uwscan.reconstruct`` was given it, in place of the calibration's; 0 takes it as exact.
    seed : int, default 1
        Seed of the random samples that the start is taken from.

    Returns
    -------
    SphereFit

    Raises
    ------
    FitError
        Where the points hold no sphere or do not determine one, or are not finite.
    CalibrationError
        Where the cloud was not made with the calibration.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> i = np.arange(300)
    >>> z = -1 + i / 300
    >>> r, t = np.sqrt(1 - z**2), 2.4 * i
    >>> ball = np.stack([20 * r * np.cos(t), 20 * r * np.sin(t), 700 + 20 * z], axis=1)
    >>> fit = uwscan.fit_sphere(ball)
    >>> round(fit.radius_mm, 9), np.round(fit.center_mm, 6).tolist()
    (20.0, [0.0, 0.0, 700.0])
    """

def merge(clouds: collections.abc.Sequence[Cloud | numpy.typing.ArrayLike], *, near_mm: SupportsFloat | SupportsIndex | None = None, least_overlap: SupportsFloat | SupportsIndex = 0.2) -> Merged:
    """
    Overlapping sweeps of one scene as one cloud: each brought onto the others' surfaces, all at once, by each point's covariance.

    Parameters
    ----------
    clouds : sequence of Cloud or array_like
        Two or more, each of one sweep; the result is in the frame of the first.
    near_mm : float, optional
        Where all clouds' coordinates agree already to within this distance, mm: look no farther.
    least_overlap : float, default 0.2
        Share of a cloud's points that must lie on the surface of another one.

    Returns
    -------
    Merged
        No points are averaged; ``uwscan.average`` does that.

    Raises
    ------
    AlignmentError
        For fewer than two clouds, one that has no surface or does not overlap with the others, and one whose overlap tells several poses or a
        whole path of them.
    InputError
        For a setting out of range.
    """

def open_capture(path: str | PathLike[str]) -> Capture:
    """
    The capture in a folder, or in a recording (.mcap).

    Parameters
    ----------
    path : str or os.PathLike
        A folder with capture.toml and frames.csv, or a recording, finished or cut off.

    Returns
    -------
    Capture
        A sequence of frames.

    Raises
    ------
    FileError, FormatError
        Where there is no capture, or one of its files is wrong. An image that is missing is no error: a ``LossWarning`` tells of it.
    """

def reconstruct(capture: Capture | str | os.PathLike[str], calibration: Calibration | str | os.PathLike[str], *, refraction: typing.Literal['exact', 'paper', 'none'] = "exact", frame: typing.Literal['camera', 'galvo'] = "camera", stripe: typing.Literal['fast', 'robust', 'precise', 'ridge', 'cog', 'blais-rioux'] = "robust", medium: typing.Literal['air', 'water'] | None = None, water_index: SupportsFloat | SupportsIndex | None = None, water: tuple[SupportsFloat | SupportsIndex, SupportsFloat | SupportsIndex, SupportsFloat | SupportsIndex] | None = None, threads: SupportsIndex | None = None, progress: collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None = None) -> Cloud:
    """
    The points of a scan, each with its covariance: what ``uwscan reconstruct`` writes, bit for bit.

    Parameters
    ----------
    capture : Capture, str or os.PathLike
        A capture of kind "scan": a folder or a recording.
    calibration : Calibration, str or os.PathLike
        Of the instrument that took it.
    refraction : str, default "exact"
        "exact" through both windows; "paper": its approximations; "none": straight.
    frame : str, default "camera"
        Frame of the points: "camera" or "galvo".
    stripe : str, default "robust"
        How a stripe's centre is estimated: a method of ``uwscan.extract_stripe``. "precise" reads noise and width off each image by itself
        and takes six times as long; its points are as near the truth.
    medium : str, optional
        What is outside the windows, "air" or "water"; by default what the capture says.
    water_index : float, optional
        The water's index at the laser's wavelength, relative to air; by default the calibration's.
    water : tuple of float, optional
        (temperature_c, salinity_psu, depth_m), which the water's index follows from.
    threads : int, optional
        Threads to work on; one a processor by default. The result does not depend on it.
    progress : callable, optional
        Told of progress as ``progress(stage, done, total)``; False tells nobody. In a notebook with tqdm a bar is shown by itself.

    Returns
    -------
    Cloud
        With all attributes; ``report`` says what was left out, and why.

    Raises
    ------
    CaptureError
        Where the capture is no scan, nothing says the water's index, or no image gave a point.
    FileError, FormatError
        Where a file is wrong. A lost image is no error: a ``LossWarning`` tells of it.
    KeyboardInterrupt
        On Ctrl-C.
    """

def report(scans: collections.abc.Sequence[str | os.PathLike[str]], output: str | os.PathLike[str], *, calibration: str | os.PathLike[str] | None = None, reference: str | os.PathLike[str] | None = None, nominal: str | os.PathLike[str] | None = None, frame: typing.Literal['camera', 'galvo'] = "camera", title: str | None = None, made: str | None = None, overwrite: bool = False, threads: SupportsIndex | None = None, progress: collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None = None) -> pathlib.Path:
    """
    Writes a page on scans and clouds: what was measured with what, shapes with both sigmas, deviations, balls beside their nominal values. What
    ``uwscan report`` writes, but for the date, which is on the page only where it is given.

    Parameters
    ----------
    scans : sequence of paths
        Captures of scans, which need a calibration, and files of clouds.
    output : str or os.PathLike
        The page (.html), one file that asks for no other; the figures go beside it as .json and .csv.
    calibration : str or os.PathLike, optional
        Calibration file of the instrument; of a cloud it adds its part of the uncertainty.
    reference : str or os.PathLike, optional
        A mesh that the scans are held against, after best fit.
    nominal : str or os.PathLike, optional
        Nominal radii and distances of the balls of an artefact (.toml or .csv).
    frame : str, default "camera"
        Frame of the points of captures: "camera" or "galvo".
    title : str, optional
        Title of the page.
    made : str, optional
        When it was made, as the page is to say it.
    overwrite : bool, default False
        Replace the files where they exist.
    threads : int, optional
        Threads to work on; one a processor by default. The page does not depend on it.
    progress : callable, optional
        As ``uwscan.reconstruct`` has it.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    InputError
        For a name that is no page's, a capture without a calibration.
    AlignmentError, CaptureError, FitError
        Where a scan can't be measured or does not come to lie on the reference.
    ExistingFileError, FileError, FormatError
        Where a file is wrong, or an output exists.
    """

def simulate(scene: str | os.PathLike[str], rig: str | os.PathLike[str] | None = None, *, output: str | os.PathLike[str], overwrite: bool = False, threads: SupportsIndex | None = None, progress: collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None = None) -> pathlib.Path:
    """
    Images of a scene as the instrument would see it, with the truth beside them: what ``uwscan simulate`` makes, bit for bit.

    Parameters
    ----------
    scene : str or os.PathLike
        Scene file (TOML).
    rig : str or os.PathLike, optional
        A rig file that replaces the one that the scene names.
    output : str or os.PathLike
        Capture folder to make, or recording where the name ends in .mcap.
    overwrite : bool, default False
        Replace the output where it exists.
    threads : int, optional
        Threads to work on; one a processor by default. The images do not depend on it.
    progress : callable, optional
        As ``uwscan.reconstruct`` has it.

    Returns
    -------
    pathlib.Path
        The folder with the truth: ``truth.json`` and ``stripes.csv``.

    Raises
    ------
    SimulationError, FormatError
        Where the scene says what can't be.
    ExistingFileError, FileError
        Where the output exists or can't be written.
    """

def stripe_codes() -> tuple[dict[str, int], dict[str, int]]:
    """
    The names of flags and reasons with their numbers, which ``uwscan.StripeFlags`` and ``uwscan.StripeReject`` are held against.
    """

def thin(cloud: Cloud | numpy.typing.ArrayLike, *, spacing_mm: SupportsFloat | SupportsIndex | None = None, flat_mm: SupportsFloat | SupportsIndex | None = None) -> Cloud:
    """
    Fewer points of a cloud, as they are: about one in each cube, or few where the surface is flat and many where it bends.

    Parameters
    ----------
    cloud : Cloud or array_like
        Points, (n, 3), mm.
    spacing_mm : float, optional
        Edge of the cubes, mm: of each, the point nearest to the middle of its points is kept.
    flat_mm : float, optional
        Instead of that: points are left out that lie within this distance of the surface through those that are kept, mm.

    Returns
    -------
    Cloud
        With all attributes, in the order of the points.

    Raises
    ------
    InputError
        Unless one of the two lengths is given, from 1e-6 to 1e6; for positions that are not finite.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
    >>> len(uwscan.thin(points, spacing_mm=5.0)), len(uwscan.thin(points, flat_mm=0.1)) < 20
    (16, True)
    """

def triangulate_surface(cloud: Cloud | numpy.typing.ArrayLike, *, sensor_mm: numpy.typing.ArrayLike | None = None, steepest_deg: SupportsFloat | SupportsIndex = 85.0, smooth: bool = False) -> Mesh:
    """
    The surface through a cloud's points, none of them moved unless `smooth` is true: triangulated in the image (or in directions from the sensor, for points
    without pixels), and cut at voids, along occlusions and across steps.

    Parameters
    ----------
    cloud : Cloud or array_like
        One sweep's points; (n, 3), mm.
    sensor_mm : array_like, optional
        Where the points were seen from, (3,), mm; the frame's origin by default.
    steepest_deg : float, default 85
        Triangles that the line of sight or the light meets at this angle to their normal, or a larger one, are left out.
    smooth : bool, default False
        Move vertices to what they and their neighbours say together, each by its sigma: the cloud must have sigmas.

    Returns
    -------
    Mesh
        With normals, and the points' sigmas and intensities as far as they have any.

    Raises
    ------
    SurfaceError
        For fewer than three points, values that are not finite, points on a line, and where no triangle is left.

    Examples
    --------
    >>> import numpy as np, uwscan
    >>> x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
    >>> mesh = uwscan.triangulate_surface(points)
    >>> round(mesh.area_mm2, 6)
    16.0
    """

def water_index(temperature_c: numpy.typing.ArrayLike, salinity_psu: numpy.typing.ArrayLike, wavelength_nm: numpy.typing.ArrayLike, depth_m: numpy.typing.ArrayLike = 0.0) -> typing.Any:
    """
    Index of refraction of water relative to air: Quan and Fry (Appl. Opt. 34 (1995) 3477), with a term linear in depth.

    Parameters
    ----------
    temperature_c : array_like
        Temperature, °C (0 to 30).
    salinity_psu : array_like
        Practical salinity (0 to 35).
    wavelength_nm : array_like
        Wavelength in air, nm (400 to 700).
    depth_m : array_like, default 0.0
        Depth below the surface, m.

    Returns
    -------
    float or numpy.ndarray
        The arguments broadcast against each other; a float where all are numbers.

    Examples
    --------
    >>> import uwscan
    >>> round(uwscan.water_index(20.0, 35.0, 532.0), 6)
    1.34151
    >>> uwscan.water_index([10.0, 20.0], 0.0, 532.0).round(5).tolist()
    [1.33569, 1.33504]
    """
