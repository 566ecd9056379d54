"""Figures with matplotlib (``pip install uwscan[plot]``).

Every function draws into the axes that it is given, or into a new figure, and returns the axes. Axes are labelled with unit and frame; colours
are those that colour-blind readers tell apart (viridis, a blue-to-red scale with a light middle, Okabe and Ito's palette).
"""

from ._axes import BLUE, ORANGE
from ._calibration import uncertainty
from ._residuals import residual_histogram, residual_map, residual_vectors
from ._scans import cloud, deviation_histogram, deviations, stripe

__all__ = [
    "BLUE",
    "ORANGE",
    "cloud",
    "deviation_histogram",
    "deviations",
    "residual_histogram",
    "residual_map",
    "residual_vectors",
    "stripe",
    "uncertainty",
]
