"""Reads clouds and meshes with packages that are not ours: clouds.py FOLDER (see clouds.sh and the example `clouds` of uw-io)."""

import pathlib
import sys

import laspy
import numpy as np
import pye57
import trimesh
from plyfile import PlyData
from pypcd4 import PointCloud

N = np.array([n for n in range(240) if n % 7 != 3])
IMAGE, LINE = N // 20, N % 20
PLACES = np.column_stack([LINE - 10.0, IMAGE * 0.5, 900.0 + N / 16.0])
folder = pathlib.Path(sys.argv[1])


def agrees(name, places, tolerance, **columns):
    assert places.shape == PLACES.shape, (name, places.shape)
    assert np.abs(places - PLACES).max() <= tolerance, name
    wanted = {"intensity": N, "frame": IMAGE, "u": 300.5 + IMAGE, "v": LINE, "sigma": 0.25, "cov_xx": 0.5, "cov_zz": 0.125}
    for column, values in columns.items():
        assert (np.asarray(values, dtype=float) == wanted[column]).all(), (name, column)
    print(f"{name}: {len(places)} points, {', '.join(columns) or 'positions'}")


ply = PlyData.read(folder / "cloud.ply")
vertex = ply["vertex"]
assert {"unit mm", "frame camera"} <= set(ply.comments)
names = ["intensity", "frame", "u", "v", "sigma", "cov_xx", "cov_zz"]
agrees("plyfile", np.column_stack([vertex[c] for c in "xyz"]), 0, **{c: vertex[c] for c in names})
assert (vertex["red"] == IMAGE).all() and (vertex["blue"] == 255).all()

for name in ["cloud.pcd", "ascii.pcd"]:
    pcd = PointCloud.from_path(folder / name)
    assert (pcd.metadata.width, pcd.metadata.height) == (20, 12), "organised by image and line"
    columns = {field: pcd.pc_data[field] for field in pcd.fields}
    there = ~np.isnan(columns["x"])
    places = np.column_stack([columns[c][there] for c in "xyz"]).astype(float)
    agrees(f"pypcd4 {name}", places, 0, **{c: columns[c][there] for c in names})
    red = columns["rgb"].astype("<f4").view("<u4")[there] >> 16 & 255
    assert (red == IMAGE).all()

for name in ["cloud.las", "cloud.laz"]:
    las = laspy.read(folder / name)
    assert las.header.version == laspy.header.Version(1, 4) and las.header.system_identifier.startswith("frame camera")
    places = np.column_stack([las.x, las.y, las.z]) * 1000.0
    agrees(f"laspy {name}", places, 1e-3, **{c: las[c] for c in names})
    assert (las.red == IMAGE * 257).all()

e57 = pye57.E57(str(folder / "cloud.e57"))
data = e57.read_scan(0, ignore_missing_fields=True, intensity=True, colors=True)
places = np.column_stack([data[f"cartesian{c}"] for c in "XYZ"]) * 1000.0
agrees("pye57", places, 1e-9, intensity=data["intensity"])
assert (data["colorRed"] == IMAGE).all()

for name, scale in [("mesh.ply", 1.0), ("mesh.stl", 1.0), ("mesh.obj", 1.0), ("mesh.glb", 1000.0)]:
    mesh = trimesh.load(folder / name, force="mesh")
    assert mesh.is_watertight and len(mesh.faces) == 4, name
    assert abs(mesh.volume * scale**3 - 1000.0) < 1e-2, (name, mesh.volume)
    print(f"trimesh {name}: closed, {mesh.volume * scale**3:.1f} mm³")
