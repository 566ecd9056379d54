#!/usr/bin/env python3
"""Speed and accuracy of the stripe extraction that people write in Python: see README.md beside this file."""

import argparse
import csv
import functools
import os
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

import cv2
import numba
import numpy as np
from scipy.special import ndtr
from skimage.feature import hessian_matrix, hessian_matrix_eigvals

cv2.setNumThreads(1)

SIZES = [(768, 576), (1920, 1200)]
SIGMA_PX = 2.0
CAMERAS = {"u8": (np.uint8, 255, 40.0, 1.0), "u16": (np.uint16, 4095, 2.5, 2.4)}


def frame(width, height, camera):
    """A frame (height, width) of the camera's type, and the stripe's centre in each column, px."""
    dtype, full, electrons, read = CAMERAS[camera]
    rng = np.random.default_rng(1)
    x, y = np.arange(width), np.arange(height)[:, None]
    centre = height / 2 + 0.15 * height * np.sin(2 * np.pi * x / width)
    share = ndtr((y + 0.5 - centre) / SIGMA_PX) - ndtr((y - 0.5 - centre) / SIGMA_PX)
    light = full * (4 / 255 + 0.6 * share * SIGMA_PX * np.sqrt(2 * np.pi))
    dn = rng.poisson(light * electrons) / electrons + rng.normal(0, read, light.shape)
    return aligned(np.clip(np.rint(dn), 0, full).astype(dtype)), centre


def aligned(array, boundary=64):
    """A copy that begins where a cache line does."""
    room = np.empty(array.nbytes + boundary, np.uint8)
    first = -room.ctypes.data % boundary
    out = room[first : first + array.nbytes].view(array.dtype).reshape(array.shape)
    out[...] = array
    return out


def numpy_cog(image):
    weight = np.maximum(image.astype(np.float32) - 0.5 * image.max(axis=0), 0)
    return (weight * np.arange(len(image), dtype=np.float32)[:, None]).sum(axis=0) / weight.sum(axis=0)


def numpy_window(image, half=4):
    top = np.clip(image.argmax(axis=0), half, len(image) - half - 1)
    rows = top + np.arange(-half, half + 1)[:, None]
    values = image[rows, np.arange(image.shape[1])].astype(np.float32)
    weight = values - values.min(axis=0)
    return (weight * rows).sum(axis=0) / weight.sum(axis=0)


@numba.njit(cache=False)
def numba_cog(image):
    height, width = image.shape
    top = np.zeros(width, image.dtype)
    for y in range(height):
        for x in range(width):
            top[x] = max(top[x], image[y, x])
    mass, moment = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for y in range(height):
        for x in range(width):
            weight = max(np.float32(image[y, x]) - np.float32(0.5) * np.float32(top[x]), np.float32(0))
            mass[x] += weight
            moment[x] += weight * np.float32(y)
    return moment / mass


@numba.njit(cache=False)
def numba_window(image):
    half = 4
    height, width = image.shape
    best, at = np.zeros(width, image.dtype), np.zeros(width, np.int32)
    for y in range(height):
        for x in range(width):
            if image[y, x] > best[x]:
                best[x], at[x] = image[y, x], y
    out = np.empty(width, np.float32)
    for x in range(width):
        middle = min(max(at[x], half), height - half - 1)
        floor = image[middle, x]
        for y in range(middle - half, middle + half + 1):
            floor = min(floor, image[y, x])
        mass, moment = np.float32(0), np.float32(0)
        for y in range(middle - half, middle + half + 1):
            weight = np.float32(image[y, x]) - np.float32(floor)
            mass += weight
            moment += weight * np.float32(y)
        out[x] = moment / mass
    return out


def parabola(values, log):
    """Vertex of the parabola through each column's maximum and its neighbours."""
    top = np.clip(values.argmax(axis=0), 1, len(values) - 2)
    columns = np.arange(values.shape[1])
    a, b, c = (values[top + k, columns].astype(np.float32) for k in (-1, 0, 1))
    if log:
        a, b, c = (np.log(np.maximum(v, 1)) for v in (a, b, c))
    bend = a - 2 * b + c
    return top + np.where(bend < 0, 0.5 * (a - c) / np.where(bend < 0, bend, 1), 0)


def opencv_u8(image):
    return parabola(cv2.GaussianBlur(image, (9, 9), SIGMA_PX), log=True)


def opencv_f32(image):
    return parabola(cv2.GaussianBlur(image.astype(np.float32), (9, 9), SIGMA_PX), log=True)


@functools.cache
def derivatives(sigma):
    """A Gaussian and its first two derivatives."""
    x = np.arange(-np.ceil(4 * sigma), np.ceil(4 * sigma) + 1)
    gauss = np.exp(-0.5 * (x / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
    # Correlation: OpenCV does not flip its kernels.
    return gauss, x / sigma**2 * gauss, (x**2 / sigma**4 - 1 / sigma**2) * gauss


def steger(image):
    smooth, first, second = derivatives(SIGMA_PX)
    image = image.astype(np.float32)
    rx = cv2.sepFilter2D(image, cv2.CV_32F, first, smooth)
    ry = cv2.sepFilter2D(image, cv2.CV_32F, smooth, first)
    rxx = cv2.sepFilter2D(image, cv2.CV_32F, second, smooth)
    ryy = cv2.sepFilter2D(image, cv2.CV_32F, smooth, second)
    rxy = cv2.sepFilter2D(image, cv2.CV_32F, first, first)
    # Eigenvector of the eigenvalue of largest magnitude, negative on a bright line.
    half, root = 0.5 * (rxx + ryy), np.hypot(0.5 * (rxx - ryy), rxy)
    value = half - root
    nx, ny = rxy, value - rxx
    swap = np.abs(rxy) < 1e-6
    nx, ny = np.where(swap, 0, nx), np.where(swap, 1, ny)
    curvature = rxx * nx * nx + 2 * rxy * nx * ny + ryy * ny * ny
    step = -(rx * nx + ry * ny) / np.where(curvature < 0, curvature, -1)
    px, py = step * nx, step * ny
    # 0.6, as in Steger's own program: with 0.5 some columns are left without a point.
    on_line = (np.abs(px) <= 0.6) & (np.abs(py) <= 0.6) & (value < 0)
    strength = np.where(on_line, -value, 0)
    top = strength.argmax(axis=0)
    columns = np.arange(image.shape[1])
    # Along the line from the point found to the column's middle.
    x, y, vx, vy = px[top, columns], py[top, columns], nx[top, columns], ny[top, columns]
    return top + y + np.where(np.abs(vy) > 1e-6, x * vx / np.where(np.abs(vy) > 1e-6, vy, 1), 0)


def skimage_hessian(image):
    matrix = hessian_matrix(image.astype(np.float32), sigma=SIGMA_PX, use_gaussian_derivatives=False)
    return parabola(-hessian_matrix_eigvals(matrix)[1], log=False)


PEERS = {
    "numpy-cog": numpy_cog, "numpy-window": numpy_window, "numba-cog": numba_cog, "numba-window": numba_window,
    "opencv-u8": opencv_u8, "opencv-f32": opencv_f32, "steger": steger, "skimage-hessian": skimage_hessian,
}
# Our kernel, the peer that its ratio is quoted against, least ratio and aim.
RATIOS = [("fast", "opencv-u8", 100, 200), ("robust", "opencv-u8", 60, 120), ("cog", "numba-cog", 12, 18),
          ("cog", "numba-window", 12, 18), ("ridge", "steger", 500, 2000)]


def best_seconds(function, image, least_runs=5, budget=1.0):
    """Shortest time of a call after a warm-up; at least `least_runs` calls, more while `budget` seconds last."""
    function(image)
    best, runs, start = float("inf"), 0, time.perf_counter()
    while runs < least_runs or time.perf_counter() - start < budget:
        before = time.perf_counter()
        function(image)
        best, runs = min(best, time.perf_counter() - before), runs + 1
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ours", metavar="CSV", help="kernel,pixel,frame,mpx_per_s: prints our ratios to the peers")
    parser.add_argument("--only", metavar="PEER", action="append", choices=PEERS)
    parser.add_argument("--budget", type=float, default=1.0, metavar="S", help="seconds for each figure")
    args = parser.parse_args()
    speed = {}
    print(f"{'peer':<16} {'pixel':<5} {'frame':<10} {'Mpx/s':>8} {'RMS, px':>8}")
    for width, height in SIZES:
        for camera in CAMERAS:
            image, centre = frame(width, height, camera)
            for name in args.only or PEERS:
                found = PEERS[name](image)
                # Blurs bend the stripe where the frame ends.
                rms = np.sqrt(np.mean((found - centre)[16:-16] ** 2))
                mpx = width * height / best_seconds(PEERS[name], image, budget=args.budget) / 1e6
                speed[name, camera, f"{width}x{height}"] = mpx
                print(f"{name:<16} {camera:<5} {width}x{height:<6} {mpx:8.1f} {rms:8.4f}", flush=True)
    if args.ours:
        with open(args.ours, newline="") as file:
            rows = csv.DictReader(file, fieldnames=["kernel", "pixel", "frame", "mpx_per_s"])
            ours = {(r["kernel"], r["pixel"], r["frame"]): float(r["mpx_per_s"]) for r in rows if r["kernel"] != "kernel"}
        print(f"\n{'ours':<8} {'against':<14} {'pixel':<5} {'frame':<10} {'ratio':>8} {'must':>6} {'aim':>6}")
        for kernel, peer, must, aim in RATIOS:
            for (name, camera, size), mpx in speed.items():
                if name == peer and (kernel, camera, size) in ours:
                    ratio = ours[kernel, camera, size] / mpx
                    print(f"{kernel:<8} {peer:<14} {camera:<5} {size:<10} {ratio:8.1f} {must:6} {aim:6}")


if __name__ == "__main__":
    main()
