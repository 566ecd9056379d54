"""The repository's fixtures, and one calibration for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from helpers import FIXTURES, ROOT

import uwscan


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    # Doctests name fixtures by their path in the repository.
    monkeypatch.chdir(ROOT)


@pytest.fixture(scope="session")
def calibration_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the calibration's report is, once it is made."""
    return tmp_path_factory.mktemp("page") / "calibration.html"


@pytest.fixture(scope="session")
def calibration(calibration_page: Path) -> uwscan.Calibration:
    cached = os.environ.get("UWSCAN_CALIBRATION")
    captures = [FIXTURES / "cal-air", FIXTURES / "cal-water"]
    return uwscan.Calibration.load(cached) if cached else uwscan.calibrate(captures, report=calibration_page, made="one fine day")


@pytest.fixture(scope="session")
def calibration_file(calibration: uwscan.Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "calibration.toml"
    calibration.save(path)
    return path


@pytest.fixture(scope="session")
def cloud(calibration: uwscan.Calibration) -> uwscan.Cloud:
    return uwscan.reconstruct(FIXTURES / "ball", calibration)


@pytest.fixture(scope="session")
def binary() -> Path:
    """The command, built from the same sources; UWSCAN names one that is there."""
    given = os.environ.get("UWSCAN")
    if given is None:
        pytest.skip("UWSCAN names no binary of the command to compare with")
    return Path(given)
