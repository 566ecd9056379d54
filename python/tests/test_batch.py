"""Archives on Dask: one corrupt recording, a killed worker, and a second run."""

from __future__ import annotations

import os
import shutil
import signal

import numpy as np
import pytest
from helpers import FIXTURES

import uwscan

distributed = pytest.importorskip("distributed")

RECORDINGS = 8


@pytest.fixture
def archive(tmp_path):
    """Several short sweeps over the ball in folders, one of them corrupt; and a calibration, which is no scan."""
    for k in range(RECORDINGS):
        folder = tmp_path / "archive" / f"dive-{k % 2}" / f"{k:02}"
        shutil.copytree(FIXTURES / "ball", folder)
        rows = (folder / "frames.csv").read_text().splitlines(keepends=True)
        (folder / "frames.csv").write_text("".join(rows[:1] + rows[1 + k : 13 + k]))
    (tmp_path / "archive" / "torn.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(200))
    shutil.copytree(FIXTURES / "cal-air", tmp_path / "archive" / "calibration")
    return tmp_path / "archive"


def test_an_archive_with_a_corrupt_recording_and_a_killed_worker(archive, calibration_file, tmp_path):
    killed = []

    def kill_one(stage, done, total):
        if done == 2 and not killed:
            pids = client.run(os.getpid)
            killed.append(pids.popitem()[1])
            os.kill(killed[0], signal.SIGKILL)

    out = tmp_path / "out"
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        rows = uwscan.batch.run(archive, calibration=calibration_file, output=out, client=client, progress=kill_one)
    assert killed
    status = {r["recording"]: r["status"] for r in rows}
    assert status.pop("torn.mcap") == "failed" and status.pop("calibration") == "skipped"
    assert len(status) == RECORDINGS and set(status.values()) == {"done"}
    clouds = sorted(p.relative_to(out).as_posix() for p in out.rglob("*.ply"))
    assert clouds == sorted(f"{name}.ply" for name in status), "each exactly once"
    cloud = uwscan.reconstruct(archive / "dive-0" / "00", calibration_file)
    np.testing.assert_array_equal(uwscan.Cloud.load(out / "dive-0" / "00.ply").points_mm, cloud.points_mm)
    table = (out / "table.csv").read_text().splitlines()
    assert len(table) == 1 + RECORDINGS + 2 and "torn.mcap,failed" in "".join(table)

    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.ply")}
    (out / "dive-1" / "01.ply").unlink()
    again = uwscan.batch.run(archive, calibration=calibration_file, output=out, workers=1)
    redone = {r["recording"] for r in again if not r["kept"]}
    assert redone == {"dive-1/01", "torn.mcap"}, "what is missing, and what had failed"
    changed = {p for p, t in before.items() if p.stat().st_mtime_ns != t}
    assert changed == {out / "dive-1" / "01.ply"}
    if (out / "table.parquet").exists():
        parquet = pytest.importorskip("pyarrow.parquet")
        assert parquet.read_table(out / "table.parquet").num_rows == RECORDINGS + 2


def test_other_settings_are_another_key(archive, calibration_file, tmp_path):
    from uwscan import _uwscan

    name, path = _uwscan.batch_jobs(archive)[1]
    first = _uwscan.batch_one(name, path, calibration_file, tmp_path)
    assert first["status"] == "done" and not first["kept"]
    assert _uwscan.batch_one(name, path, calibration_file, tmp_path)["kept"]
    other = _uwscan.batch_one(name, path, calibration_file, tmp_path, frame="galvo")
    assert not other["kept"] and other["key"] != first["key"]
    assert uwscan.Cloud.load(tmp_path / f"{name}.ply").frame == "galvo"


def test_what_can_not_begin_is_an_error(archive, calibration_file, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(uwscan.CaptureError, match="no recording"):
        uwscan.batch.run(tmp_path / "empty", calibration=calibration_file, output=tmp_path / "out")
    with pytest.raises(uwscan.MissingFileError):
        uwscan.batch.run(archive, calibration=tmp_path / "none.toml", output=tmp_path / "out")
    with pytest.raises(uwscan.InputError, match="speed"):
        uwscan.batch.run(archive, calibration=calibration_file, output=tmp_path / "out", speed=11)
