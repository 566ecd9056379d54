#!/usr/bin/env python3
"""Fits, normals, shapes and meshes of the same clouds by this project, Open3D and pyransac3d: accuracy and time, and their ratios.

    cargo build --release --package uw-cloud --example cloud_peers
    python benches/peers/clouds.py [--ours target/release/examples/cloud_peers] [--points 36000] [--seeds 3]

One thread everywhere. Times are processor time of the operation inside its process, the shortest of several runs: reading files and starting up does not count, nor what others do on the machine.
"""
import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import pathlib
import subprocess
import tempfile
import time

import numpy as np
import open3d as o3d
import pyransac3d

NOISE_MM = 0.05
OUTLIERS = 0.3
THRESHOLD_MM = 4 * NOISE_MM  # what the peers are told; ours is told nothing
TRIALS = 1000


def write_points(path, points):
    path.write_bytes(np.ascontiguousarray(points, "<f8").tobytes())


def with_outliers(rng, points):
    """Three tenths of the points anywhere in the box about them."""
    low, high = points.min(0) - 20, points.max(0) + 20
    strays = rng.uniform(low, high, (int(len(points) * OUTLIERS / (1 - OUTLIERS)), 3))
    return rng.permutation(np.r_[points, strays])


def noisy(rng, points):
    return points + NOISE_MM * rng.standard_normal(points.shape)


def plate(rng, n):
    x, y = rng.uniform(-80, 80, (2, n))
    return np.c_[x, y, 900 + 0.1 * x - 0.2 * y]


def ball(rng, n, radius=20.0175, center=(15, -20, 867)):
    """The near half of a ball."""
    z, t = -rng.uniform(0, 1, n), rng.uniform(0, 2 * np.pi, n)
    r = np.sqrt(1 - z * z)
    return np.array(center) + radius * np.c_[r * np.cos(t), r * np.sin(t), z]


def pipe(rng, n, radius=44.45):
    x, t = rng.uniform(-100, 100, n), rng.uniform(1.1 * np.pi, 1.9 * np.pi, n)
    return np.c_[x, radius * np.cos(t), 900 + radius * np.sin(t)]


def wave(x, y):
    return 900 + 4 * np.sin(x / 12) + 3 * np.cos(y / 15)


def wave_normals(x, y):
    n = np.c_[4 / 12 * np.cos(x / 12), -3 / 15 * np.sin(y / 15), -np.ones_like(x)]
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def sheet(rng, n):
    """A wavy surface in stripes, as a sweep has it."""
    stripes = int(np.sqrt(n / 2.5))
    x, y = np.meshgrid(np.linspace(-80, 80, stripes), np.linspace(-60, 60, n // stripes), indexing="ij")
    x, y = x.ravel(), y.ravel()
    p = np.c_[x, y, wave(x, y)]
    return p * (1 + NOISE_MM * rng.standard_normal((len(p), 1)) / 900)  # along the sight


def artefact(rng, n):
    """Three balls before a plate."""
    parts = [ball(rng, n // 6, r, c) for r, c in ((30, (60, -50, 860)), (25, (-70, -20, 880)), (20, (10, 60, 850)))]
    return np.r_[plate(rng, n // 2), *parts]


def timed(run, least=3):
    best, began = np.inf, time.perf_counter()
    for done in range(1, 100):
        start = time.process_time()
        result = run()
        best = min(best, time.process_time() - start)
        if done >= least and time.perf_counter() - began > 1 or time.perf_counter() - began > 20:
            return best, result


def o3d_cloud(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def turn(a, b):
    """Angle between two lines, degrees."""
    return np.degrees(np.arcsin(min(1, np.linalg.norm(np.cross(a, b)) / np.linalg.norm(a) / np.linalg.norm(b))))


def off_wave(points):
    """Distances from the wavy sheet, to first order."""
    x, y, z = points.T
    n = wave_normals(x, y)
    return np.abs((z - wave(x, y)) * n[:, 2])


def mesh_error(vertices, triangles):
    """Median and 99 % of how far the triangles' middles lie off, within the sheet, mm, and the share of the sheet that they cover, seen along z: noise makes any surface's area larger."""
    corners = vertices[triangles]
    middle = corners.mean(1)
    inside = (np.abs(middle[:, 0]) < 80) & (np.abs(middle[:, 1]) < 60)
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0])[:, :2].T for k in (1, 2))
    area = 0.5 * np.abs(ax * by - ay * bx)
    off = off_wave(middle[inside])
    return np.median(off), np.percentile(off, 99), area[inside].sum() / (160 * 120)


class Table:
    def __init__(self):
        self.rows = {}

    def add(self, task, who, seconds, error):
        self.rows.setdefault((task, who), []).append((seconds, error))

    def print(self):
        print(f"{'task':<42}{'who':<24}{'ms':>9}{'error':>12}{'time/ours':>11}{'error/ours':>12}")
        typical = {key: np.median([r[0] for r in rows]) for key, rows in self.rows.items()}
        worth = {key: np.sqrt(np.mean([r[1] ** 2 for r in rows])) for key, rows in self.rows.items()}
        for task, who in self.rows:
            t, e = typical[task, who], worth[task, who]
            print(f"{task:<42}{who:<24}{1e3 * t:>9.1f}{e:>12.5f}{t / typical[task, 'uwscan']:>11.2f}{e / worth[task, 'uwscan']:>12.2f}")


def ours(binary, points, *operations, other=None):
    """Returns {operation: (seconds, words)}, and a dictionary of normals, meshes and outliers where they were asked for."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        write_points(folder / "cloud.f64", points)
        if other is not None:
            write_points(folder / "other.f64", other)
        done = subprocess.run([binary, folder, *operations], capture_output=True, text=True, check=True)
        lines = [line.split() for line in done.stdout.splitlines()]
        made = {}
        if "normals" in operations:
            made["normals"] = np.loadtxt(folder / "normals.txt")
        for mesh in {"mesh", "smoothed"}.intersection(operations):
            vertices = np.fromfile(folder / f"{mesh}.vertices.f64", "<f8").reshape(-1, 3)
            made[mesh] = vertices, np.fromfile(folder / f"{mesh}.triangles.u32", "<u4").reshape(-1, 3)
        if "outliers" in operations:
            made["outliers"] = np.fromfile(folder / "outliers.u8", np.uint8).astype(bool)
        return {line[0]: (float(line[1]), line[2:]) for line in lines}, made


def fits(binary, rng, n, table):
    x = with_outliers(rng, noisy(rng, plate(rng, int(n * (1 - OUTLIERS)))))
    true = np.array([0.1, -0.2, -1])
    seconds, words = ours(binary, x, "plane")[0]["plane"]
    table.add("plane, angle °", "uwscan", seconds, turn(np.array(words[:3], float), true))
    cloud = o3d_cloud(x)
    seconds, (model, _) = timed(lambda: cloud.segment_plane(THRESHOLD_MM, 3, TRIALS))
    table.add("plane, angle °", "open3d", seconds, turn(model[:3], true))
    seconds, (model, _) = timed(lambda: pyransac3d.Plane().fit(x, THRESHOLD_MM, maxIteration=TRIALS))
    table.add("plane, angle °", "pyransac3d", seconds, turn(model[:3], true))

    x = with_outliers(rng, noisy(rng, ball(rng, int(n * (1 - OUTLIERS)))))
    seconds, words = ours(binary, x, "sphere")[0]["sphere"]
    table.add("ball, radius mm", "uwscan", seconds, abs(float(words[0]) - 20.0175))
    seconds, (_, radius, _) = timed(lambda: pyransac3d.Sphere().fit(x, THRESHOLD_MM, maxIteration=TRIALS))
    table.add("ball, radius mm", "pyransac3d", seconds, abs(radius - 20.0175))

    x = with_outliers(rng, noisy(rng, pipe(rng, int(n * (1 - OUTLIERS)))))
    seconds, words = ours(binary, x, "cylinder")[0]["cylinder"]
    table.add("pipe, radius mm", "uwscan", seconds, abs(float(words[0]) - 44.45))
    seconds, (_, _, radius, _) = timed(lambda: pyransac3d.Cylinder().fit(x, THRESHOLD_MM, maxIteration=TRIALS))
    table.add("pipe, radius mm", "pyransac3d", seconds, abs(radius - 44.45))


def surfaces(binary, rng, n, table):
    x = sheet(rng, n)
    true = wave_normals(x[:, 0], x[:, 1])
    found, made = ours(binary, x, "normals", "mesh", "smoothed")

    def angles(normals):
        return np.degrees(np.sqrt(np.nanmean(np.arccos(np.clip(np.abs((normals * true).sum(1)), 0, 1)) ** 2)))

    table.add("normals, rms °", "uwscan", found["normals"][0], angles(made["normals"]))
    cloud = o3d_cloud(x)
    neighbours = o3d.geometry.KDTreeSearchParamKNN(24)

    def estimate():
        cloud.estimate_normals(neighbours)
        cloud.orient_normals_towards_camera_location(np.zeros(3))

    seconds, _ = timed(estimate)
    table.add("normals, rms °", "open3d", seconds, angles(np.asarray(cloud.normals)))

    def add(who, seconds, vertices, triangles):
        middle, far, share = mesh_error(np.asarray(vertices), np.asarray(triangles))
        table.add("mesh, median off mm", who, seconds, middle)
        table.add("mesh, 99 % off mm", who, seconds, far)
        table.add("mesh, |covered - 1|", who, seconds, max(abs(share - 1), 1e-4))

    add("uwscan", found["mesh"][0], *made["mesh"])
    add("uwscan smoothed", found["smoothed"][0], *made["smoothed"])
    poisson = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson
    seconds, made = timed(lambda: poisson(cloud, depth=8, n_threads=1)[0], 1)
    add("open3d poisson 8", seconds, made.vertices, made.triangles)
    spacing = np.mean(np.asarray(cloud.compute_nearest_neighbor_distance()))
    radii = o3d.utility.DoubleVector([spacing, 2 * spacing, 4 * spacing])
    pivoting = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting
    seconds, made = timed(lambda: pivoting(cloud, radii), 1)
    add("open3d ball pivoting", seconds, made.vertices, made.triangles)


def outliers(binary, rng, n, table):
    """One point in fifty anywhere in the box about a wavy sheet; wrong is who misses one that lies 5 mm off or more, or takes one of the sheet."""
    x = sheet(rng, int(0.98 * n))
    strays = rng.uniform(x.min(0) - 20, x.max(0) + 20, (n - len(x), 3))
    strays = strays[off_wave(strays) > 5]
    order = rng.permutation(len(x) + len(strays))
    points, astray = np.r_[x, strays][order], (order >= len(x))
    found, made = ours(binary, points, "outliers")
    table.add("outliers, share wrong", "uwscan", found["outliers"][0], max(np.mean(made["outliers"] != astray), 1e-6))
    cloud = o3d_cloud(points)
    seconds, (_, kept) = timed(lambda: cloud.remove_statistical_outlier(12, 3.0))
    taken = np.ones(len(points), bool)
    taken[np.asarray(kept)] = False
    table.add("outliers, share wrong", "open3d", seconds, max(np.mean(taken != astray), 1e-6))


def alignment(binary, rng, n, table):
    """A second sweep over the sheet, 1 mm and half a degree away, brought back."""
    x, y = sheet(rng, n), sheet(rng, n)
    angle, shift, middle = np.radians(0.5), np.array([0.6, -0.5, 0.6]), np.array([0, 0, 900])
    turn_back = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = (y - middle) @ turn_back.T + middle + shift
    corners = np.array([[sx * 70, sy * 50, 900.0] for sx in (-1, 1) for sy in (-1, 1)])
    away = (corners - middle) @ turn_back.T + middle + shift

    def off(pose):
        return np.linalg.norm(away @ pose[:3, :3].T + pose[:3, 3] - corners, axis=1).max()

    found, _ = ours(binary, x, "icp", other=moved)
    seconds, words = found["icp"]
    table.add("alignment, worst corner mm", "uwscan", seconds, off(np.array(words, float).reshape(4, 4)))
    target, source = o3d_cloud(x), o3d_cloud(moved)
    icp, plane = o3d.pipelines.registration.registration_icp, o3d.pipelines.registration.TransformationEstimationPointToPlane()
    until = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=100)

    def align():
        target.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(24))
        return icp(source, target, 5.0, np.eye(4), plane, until)

    seconds, result = timed(align)
    table.add("alignment, worst corner mm", "open3d", seconds, off(np.asarray(result.transformation)))


def shapes(binary, rng, n, table):
    x = rng.permutation(noisy(rng, artefact(rng, n)))
    radii = [30, 25, 20]
    seconds, words = ours(binary, x, "shapes")[0]["shapes"]
    found = [(kind, float(value)) for kind, value in zip(words[::2], words[1::2])]
    spheres = sorted((value for kind, value in found if kind == "sphere"), reverse=True)
    extra = len(found) - 4
    error = max(abs(a - b) for a, b in zip(spheres, radii)) if len(spheres) == 3 and extra == 0 else np.nan
    table.add("three balls and plate, worst radius mm", "uwscan", seconds, error)

    def sequential():
        """What one writes with pyransac3d: the plate, then a ball at a time."""
        _, inliers = pyransac3d.Plane().fit(x, THRESHOLD_MM, maxIteration=TRIALS)
        left, got = np.delete(x, inliers, 0), []
        for _ in radii:
            _, radius, inliers = pyransac3d.Sphere().fit(left, THRESHOLD_MM, maxIteration=TRIALS)
            left = np.delete(left, inliers, 0)
            got.append(radius)
        return sorted(got, reverse=True)

    seconds, got = timed(sequential, 1)
    table.add("three balls and plate, worst radius mm", "pyransac3d", seconds, max(abs(a - b) for a, b in zip(got, radii)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ours", default="target/release/examples/cloud_peers")
    parser.add_argument("--points", type=int, default=36000)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    table = Table()
    for seed in range(arguments.seeds):
        for part in (fits, surfaces, outliers, alignment, shapes):
            o3d.utility.random.seed(seed)
            np.random.seed(seed)
            part(arguments.ours, np.random.default_rng(seed), arguments.points, table)
    table.print()


if __name__ == "__main__":
    main()
