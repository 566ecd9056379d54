"""The promised surface: names, keywords and defaults that users' code rests on. More may be added; none may go."""

from __future__ import annotations

import importlib.metadata
import inspect
import subprocess
import sys

import numpy as np
import pytest
from helpers import FIXTURES, bell

import uwscan

PROMISED = {
    "extract_stripe": (["image"], dict(axis="rows", method="robust", noise=None, sigma_px=None, threshold=None, roi=None)),
    "open_capture": (["path"], {}),
    "calibrate": (["captures"], dict(rig=None, method="joint", report=None)),
    "reconstruct": (["capture", "calibration"], dict(refraction="exact", frame="camera", threads=None, progress=None)),
    "fit_sphere": (["points"], dict(covariance_mm2=None, sigma_mm=None, radius_mm=None, calibration=None)),
    "fit_plane": (["points"], dict(covariance_mm2=None, sigma_mm=None, calibration=None)),
    "fit_cylinder": (["points"], dict(covariance_mm2=None, sigma_mm=None, radius_mm=None, calibration=None)),
    "fit_circle": (["points"], dict(covariance_mm2=None, sigma_mm=None, radius_mm=None, calibration=None)),
    "find_shapes": (["points"], {}),
    "triangulate_surface": (["cloud"], {}),
    "water_index": (["temperature_c", "salinity_psu", "wavelength_nm", "depth_m"], {}),
    "simulate": (["scene", "rig"], {}),
}


@pytest.mark.parametrize("name", PROMISED)
def test_functions_take_what_was_promised(name):
    positional, keywords = PROMISED[name]
    parameters = inspect.signature(getattr(uwscan, name)).parameters
    assert [p for p, v in parameters.items() if v.kind is not v.KEYWORD_ONLY] == positional
    if name == "water_index":
        assert parameters["depth_m"].default == 0.0
    for keyword, default in keywords.items():
        assert parameters[keyword].kind is inspect.Parameter.KEYWORD_ONLY
        assert parameters[keyword].default == default, keyword


def test_attributes_that_were_promised():
    stripe = uwscan.extract_stripe(bell())
    for name in ["position_px", "amplitude", "width_px", "background", "sigma_px", "chi2", "rival_ratio"]:
        assert getattr(stripe, name).dtype == np.float32
    assert isinstance(uwscan.StripeFlags(int(stripe.flags[0])), uwscan.StripeFlags)
    noise = uwscan.NoiseModel(40.0, 1.0)
    assert (noise.speckle_contrast, noise.full_scale_dn) == (0.0, 255.0)
    for cls, names in {
        uwscan.Calibration: "load save camera_matrix distortion axis_point_mm axis_direction sigmas covariance",
        uwscan.Cloud: "points_mm intensity frame_index pixel sigma_mm covariance_mm2 save load",
        uwscan.Mesh: "vertices_mm triangles save",
        uwscan.Scanner: "project back_project triangulate",
        uwscan.Camera: "project back_project",
        uwscan.Port: "project back_project",
        uwscan.Fan: "apex_mm",
        uwscan.NoiseModel: "from_flat_fields",
    }.items():
        for name in names.split():
            assert hasattr(cls, name), f"{cls.__name__}.{name}"
    assert issubclass(uwscan.UwscanError, Exception)
    assert uwscan.__version__ == importlib.metadata.version("uwscan")


def test_everything_public_is_documented():
    for name in uwscan.__all__:
        item = getattr(uwscan, name)
        if callable(item):
            assert item.__doc__, name
            for attribute, value in vars(item).items() if isinstance(item, type) else ():
                if not attribute.startswith("_") and not isinstance(value, item):
                    assert getattr(value, "__doc__", None), f"{name}.{attribute}"


def test_importing_it_imports_nothing_but_numpy():
    code = "import sys, numpy; before = set(sys.modules); import uwscan; print(*{m.split('.')[0] for m in set(sys.modules) - before})"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    third = {m for m in loaded if m not in sys.stdlib_module_names} - {"uwscan"}
    assert not third


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch):
    readme = (FIXTURES.parent / "README.md").read_text()
    section = readme.split("## From Python", 1)[1]
    code = section.split("```python\n", 1)[1].split("```", 1)[0]
    said = section.split("```text\n", 1)[1].split("```", 1)[0]
    (tmp_path / "fixtures").symlink_to(FIXTURES)
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    printed: list[str] = []
    exec(code, {"print": lambda *a: printed.append(" ".join(map(str, a)))})
    assert "\n".join(printed) + "\n" == said
