"""Underwater laser-line scanning: calibration, exact refraction, point clouds and measurements.

Arrays are NumPy's. Lengths are millimetres, pixel (0, 0) is the centre of the top-left pixel, the camera frame is x right, y down, z
forward. Calls that take one image also take a stack ``(n, height, width)``. Long calls release the GIL, take ``threads=`` and
``progress=``, and end on Ctrl-C. Errors are subclasses of `UwscanError`, in `uwscan.errors`.

`uwscan.plot` draws (``pip install uwscan[plot]``), `uwscan.viewer` shows clouds in other programs, `uwscan.interchange` hands data to and
from other packages, `uwscan.batch` works through folders of recordings (``pip install uwscan[dask]``).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from . import errors as errors
from ._uwscan import (
    Calibration,
    Camera,
    CameraFit,
    Capture,
    CircleFit,
    Cloud,
    Comparison,
    CylinderFit,
    Fan,
    Frame,
    Galvo,
    Merged,
    Mesh,
    NoiseModel,
    PlaneFit,
    Port,
    ResidualTable,
    Residuals,
    Scanner,
    Shapes,
    SphereFit,
    Stripe,
    __version__,
    average,
    calibrate,
    calibrate_camera,
    compare,
    estimate_normals,
    extract_stripe,
    find_outliers,
    find_shapes,
    fit_circle,
    fit_cylinder,
    fit_plane,
    fit_sphere,
    merge,
    open_capture,
    reconstruct,
    report,
    simulate,
    thin,
    triangulate_surface,
    water_index,
)
from .codes import StripeFlags, StripeReject
from .errors import (
    AlignmentError,
    CalibrationError,
    CaptureError,
    DtypeError,
    ExistingFileError,
    FileError,
    FitError,
    FormatError,
    GeometryError,
    InputError,
    InstrumentError,
    LossWarning,
    MissingFileError,
    SimulationError,
    SurfaceError,
    UwscanError,
    UwscanWarning,
)

if TYPE_CHECKING:
    from . import batch as batch
    from . import interchange as interchange
    from . import plot as plot
    from . import viewer as viewer

__all__ = [
    "AlignmentError",
    "Calibration",
    "CalibrationError",
    "Camera",
    "CameraFit",
    "Capture",
    "CaptureError",
    "CircleFit",
    "Cloud",
    "Comparison",
    "CylinderFit",
    "DtypeError",
    "ExistingFileError",
    "Fan",
    "FileError",
    "FitError",
    "FormatError",
    "Frame",
    "Galvo",
    "GeometryError",
    "InputError",
    "InstrumentError",
    "LossWarning",
    "Merged",
    "Mesh",
    "MissingFileError",
    "NoiseModel",
    "PlaneFit",
    "Port",
    "ResidualTable",
    "Residuals",
    "Scanner",
    "Shapes",
    "SimulationError",
    "SphereFit",
    "Stripe",
    "StripeFlags",
    "StripeReject",
    "SurfaceError",
    "UwscanError",
    "UwscanWarning",
    "__version__",
    "average",
    "calibrate",
    "calibrate_camera",
    "compare",
    "estimate_normals",
    "extract_stripe",
    "find_outliers",
    "find_shapes",
    "fit_circle",
    "fit_cylinder",
    "fit_plane",
    "fit_sphere",
    "merge",
    "open_capture",
    "reconstruct",
    "report",
    "simulate",
    "thin",
    "triangulate_surface",
    "water_index",
]

_LAZY = ("plot", "viewer", "interchange", "batch")


def __getattr__(name: str) -> object:
    # What needs other packages is imported when it is first named.
    if name in _LAZY:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
