"""What tests share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "fixtures"


def bell(width: int = 96, height: int = 64, at: float = 40.25, slope: float = 0.0, sigma: float = 2.0) -> np.ndarray:
    """An image with one stripe down it, uint8."""
    y, x = np.mgrid[:height, :width]
    return (10 + 180 * np.exp(-0.5 * ((x - at - slope * y) / sigma) ** 2)).astype(np.uint8)
