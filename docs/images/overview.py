#!/usr/bin/env python3
"""Draws overview.png from what `just pictures` computed; needs numpy, matplotlib and pillow."""
import pathlib

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SCAN = ROOT / "fixtures" / "cover"
FRAME = 74
TYPES = {"double": "<f8", "float": "<f4", "int": "<i4"}
CENTRE, BOX = "#ffb000", "#40b0ff"


def read_ply(path):
    """The vertices of a binary PLY as a structured array."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    words = [line.split() for line in head.decode().splitlines()]
    dtype = np.dtype([(w[2], TYPES[w[1]]) for w in words if w[0] == "property"])
    count = next(int(w[2]) for w in words if w[:2] == ["element", "vertex"])
    return np.frombuffer(body, dtype, count)


def show(axes, image, region, bright):
    """One part (u0, u1, v0, v1) of the image; pixel centres lie on whole numbers."""
    u0, u1, v0, v1 = region
    axes.imshow(np.sqrt(image), cmap="gray", vmin=0, vmax=np.sqrt(bright), interpolation="nearest")
    axes.set(xlim=(u0 - 0.5, u1 + 0.5), ylim=(v1 + 0.5, v0 - 0.5))


cloud = read_ply(ROOT / "target" / "picture" / "cover.ply")
file = (SCAN / "frames.csv").read_text().splitlines()[1 + FRAME].split(",")[0]
image = np.asarray(Image.open(SCAN / file), float)
stripe = cloud[cloud["frame"] == FRAME]

plt.rcParams.update({"font.size": 9, "font.family": "DejaVu Sans", "axes.titlesize": 9.5})
figure = plt.figure(figsize=(9.0, 4.0), layout="constrained")
left, middle, right = figure.subplots(1, 3, width_ratios=[0.78, 0.78, 1.75])

middle_u, middle_v = np.median(stripe["u"]), np.median(stripe["v"])
wide = (int(middle_u) - 76, int(middle_u) + 76, int(stripe["v"].min()) - 12, int(stripe["v"].max()) + 12)
step = np.abs(np.diff(stripe["u"])) > 4
row = int(stripe["v"][1:][step][0]) if step.any() else int(middle_v)
near = stripe[np.abs(stripe["v"] - row) <= 14]
centre_u = int(np.median(near["u"]))
close = (centre_u - 14, centre_u + 14, row - 27, row + 33)
bright = np.percentile(image[image > 20], 98)

show(left, image, wide, bright)
size = (close[1] - close[0], close[3] - close[2])
left.add_patch(Rectangle((close[0], close[2]), *size, fill=False, color=BOX, lw=1.3))
left.set(title="(a) one image", xlabel="u (px)", ylabel="v (px)")
show(middle, image, close, bright)
middle.errorbar(stripe["u"], stripe["v"], fmt="o", ms=2.6, color=CENTRE, mec="black", mew=0.3)
middle.set(title="(b) stripe centres", xlabel="u (px)")
for spine in middle.spines.values():
    spine.set(color=BOX, linewidth=1.5)

# Far points first, so that near ones lie on top.
order = np.argsort(-cloud["z"])
x, y, z = (cloud[axis][order] for axis in "xyz")
dots = right.scatter(x, y, c=z, s=0.9, cmap="viridis_r", lw=0)
right.set(aspect="equal", xticks=range(-60, 61, 30), yticks=range(-60, 61, 30))
right.set(title=f"(c) the sweep's {len(cloud):,} points", xlabel="x (mm)", ylabel="y (mm)")
right.invert_yaxis()
right.set_facecolor("#f2f2f2")
figure.colorbar(dots, ax=right, shrink=0.85).set_label("depth z (mm), camera frame")

target = HERE / "overview.png"
figure.savefig(target, dpi=165)
# The eye does not miss the last three bits, and the file is a third smaller without them.
drawn = np.asarray(Image.open(target).convert("RGB")).astype(int)
Image.fromarray(np.minimum((drawn + 4) // 8 * 8, 255).astype(np.uint8)).save(target, optimize=True)
print(target, target.stat().st_size, "bytes")
