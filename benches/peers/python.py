"""What a call from Python costs over the same work in Rust, and beside OpenCV and NumPy in the same run.

    .venv/bin/python benches/peers/python.py CALIBRATION [--uwscan target/release/uwscan]

Build the module with optimisation first: maturin develop --release. The work in Rust is timed by a stack: the slope of its time over the number of
frames is a frame's own work with one copy of the results, the rest of a single call is the call.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import uwscan

FIXTURES = Path(__file__).parents[2] / "fixtures"
WIDTH, HEIGHT = 768, 576


def best(call: Callable[[], object], seconds: float = 1.0) -> float:
    """Least time of a call, s."""
    times = []
    until = time.perf_counter() + seconds
    while time.perf_counter() < until or len(times) < 3:
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


def image() -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    at = WIDTH / 2 + 0.15 * WIDTH * np.sin(2 * np.pi * y / HEIGHT)
    clean = 4 + 150 * np.exp(-0.5 * ((x - at) / 2) ** 2)
    noisy = np.random.default_rng(1).poisson(clean * 40) / 40
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def per_frame(image: np.ndarray, given: dict[str, object]) -> tuple[float, float]:
    """What a frame in a stack costs besides its rows, and what a row costs, s: of frames of few rows, the line through their times by rows."""
    frames, rows = 2048, np.array([2, 4, 8, 16])
    times = []
    for number in rows:
        few = np.ascontiguousarray(image[:number])
        stack, one = np.broadcast_to(few, (frames, number, WIDTH)), few[None]
        more = best(lambda stack=stack: uwscan.extract_stripe(stack, **given)) - best(lambda one=one: uwscan.extract_stripe(one, **given))
        times.append(more / (frames - 1))
    slope, intercept = np.polyfit(rows, times, 1)
    return float(intercept), float(slope)


def calls() -> None:
    one = image()
    noise = uwscan.NoiseModel(40, 1)
    given = {"method": "fast", "noise": noise, "sigma_px": 2.0}
    # The same image over and over, so that all of them are in cache as the single one is.
    stack = {n: np.broadcast_to(one, (n, HEIGHT, WIDTH)) for n in (8, 64)}
    single = best(lambda: uwscan.extract_stripe(one, **given))
    out = uwscan.extract_stripe(one, **given)
    filled = best(lambda: uwscan.extract_stripe(one, out=out, **given))
    many = {n: best(lambda n=n: uwscan.extract_stripe(stack[n], **given)) for n in stack}
    slope = (many[64] - many[8]) / 56
    # An image of two rows costs nothing but the call.
    small = np.ascontiguousarray(one[:2])
    call = best(lambda: uwscan.extract_stripe(small, **given))
    frame, row = per_frame(one, given)
    print(f"extract_stripe, fast, {WIDTH} x {HEIGHT} px, uint8, one thread")
    print(f"  one frame              {single * 1e6:8.1f} µs, with out= {filled * 1e6:.1f} µs")
    print(f"  a frame more in a stack{slope * 1e6:8.1f} µs")
    print(f"  single over stack      {(single - slope) * 1e6:8.1f} µs; a call on two rows {call * 1e6:.1f} µs")
    print(f"  a frame in a stack costs {frame * 1e6:.2f} µs beside {row * 1e9:.1f} ns a row")
    try:
        import cv2

        cv2.setNumThreads(1)

        def opencv() -> None:
            blurred = cv2.GaussianBlur(one, (9, 1), 2)
            peak = blurred.argmax(axis=1).clip(1, WIDTH - 2)
            at = np.take_along_axis(blurred, peak[:, None] + [-1, 0, 1], axis=1).astype(np.float32) + 1
            a, b, c = np.log(at).T
            _ = peak + 0.5 * (a - c) / (a - 2 * b + c)

        print(f"  OpenCV blur, argmax, parabola {best(opencv) * 1e6:8.1f} µs")
    except ImportError:
        print("  (no OpenCV to compare with)")
    x = np.arange(WIDTH, dtype=np.float32)

    def numpy_cog() -> None:
        light = np.where(one > 0.5 * one.max(axis=1, keepdims=True), one, 0).astype(np.float32)
        _ = light @ x / light.sum(axis=1)

    print(f"  NumPy centre of gravity       {best(numpy_cog) * 1e6:8.1f} µs")


def reconstruct(calibration: Path, binary: Path | None) -> None:
    loaded = uwscan.Calibration.load(calibration)
    scan = FIXTURES / "cover"

    def python(threads: int | None = None) -> None:
        uwscan.reconstruct(scan, loaded, threads=threads, progress=False)

    print("reconstruct, fixtures/cover")
    ours = best(python, 3)
    print(f"  Python, all threads    {ours:8.3f} s")
    if binary is not None:
        with tempfile.TemporaryDirectory() as folder:

            def command() -> None:
                arguments = ["reconstruct", scan, "-c", calibration, "-o", f"{folder}/c.ply", "--force", "-q"]
                subprocess.run([binary, *arguments], check=True, stdout=subprocess.DEVNULL)

            def whole() -> None:
                cloud = uwscan.reconstruct(scan, uwscan.Calibration.load(calibration), progress=False)
                cloud.save(f"{folder}/p.ply", overwrite=True)

            theirs, same = best(command, 3), best(whole, 3)
        print(f"  the command            {theirs:8.3f} s; the same from Python, file to file {same:.3f} s, ratio {same / theirs:.3f}")
    one = best(lambda: python(1), 3)

    def two() -> None:
        threads = [threading.Thread(target=python, args=(1,)) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    both = best(two, 3)
    print(f"  threads=1              {one:8.3f} s; two of them in two Python threads {both:.3f} s: {2 * one / both:.2f} times one")


def imports() -> None:
    code = "import time, numpy; t = time.perf_counter(); import uwscan; print(time.perf_counter() - t)"
    times = [float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout) for _ in range(15)]
    print(f"import uwscan after numpy: {1e3 * min(times):.1f} ms at best, {1e3 * float(np.median(times)):.1f} in the median")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--uwscan", type=Path)
    parsed = parser.parse_args()
    calls()
    imports()
    reconstruct(parsed.calibration, parsed.uwscan)
