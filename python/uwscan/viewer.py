"""Clouds and meshes in other programs' windows: Open3D, PyVista or rerun, whichever is installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from . import errors, interchange
from ._uwscan import Cloud, Mesh

__all__ = ["show"]

_ALL: tuple[Literal["open3d", "pyvista", "rerun"], ...] = ("open3d", "pyvista", "rerun")
_PROGRAMS = {"open3d": "open3d", "pyvista": "pyvista", "rerun": "rerun"}


def show(what: Cloud | Mesh, *, program: Literal["open3d", "pyvista", "rerun"] | None = None, name: str = "uwscan") -> Any:
    """Shows a cloud or a mesh in a window.

    Parameters
    ----------
    what : Cloud or Mesh
        Clouds are coloured by depth.
    program : str, optional
        "open3d", "pyvista" or "rerun"; the first of them that is installed by default.
    name : str, default "uwscan"
        Title of the window; of rerun the entity's path.

    Returns
    -------
    object
        What the program returns, where it returns anything.

    Raises
    ------
    ImportError
        Where none of them, or not the one that was asked for, is installed.
    """
    if program is None:
        installed: list[Literal["open3d", "pyvista", "rerun"]] = [p for p in _ALL if find_spec(_PROGRAMS[p])]
        program = installed[0] if installed else None
        if program is None:
            raise ImportError("uwscan.viewer needs open3d, pyvista or rerun-sdk: pip install one of them")
    if program not in _PROGRAMS:
        raise errors.InputError(f"program must be open3d, pyvista or rerun, got {program!r}")
    if find_spec(_PROGRAMS[program]) is None:
        raise ImportError(f"{program} is not installed: pip install {'rerun-sdk' if program == 'rerun' else program}")
    return {"open3d": _open3d, "pyvista": _pyvista, "rerun": _rerun}[program](what, name)


def _open3d(what: Cloud | Mesh, name: str) -> Any:
    import open3d  # type: ignore[import-not-found, import-untyped, unused-ignore]

    return open3d.visualization.draw_geometries([interchange.to_open3d(what)], window_name=name)


def _pyvista(what: Cloud | Mesh, name: str) -> Any:
    data = interchange.to_pyvista(what)
    scalars = "sigma_mm" if "sigma_mm" in data.point_data else None
    return data.plot(scalars=scalars, cmap="viridis", window_size=(1024, 768), text=name)


def _rerun(what: Cloud | Mesh, name: str) -> Any:
    import rerun  # type: ignore[import-not-found, import-untyped, unused-ignore]

    rerun.init(name, spawn=True)
    if isinstance(what, Cloud):
        z = what.points_mm[:, 2]
        share = np.interp(z, np.percentile(z, [2, 98]), [0, 255]).astype(np.uint8)
        colours = np.stack([share, 255 - share, np.full_like(share, 160)], axis=1)
        return rerun.log(name, rerun.Points3D(what.points_mm, colors=colours))
    return rerun.log(
        name,
        rerun.Mesh3D(vertex_positions=what.vertices_mm, triangle_indices=what.triangles, vertex_normals=what.normals),
    )
