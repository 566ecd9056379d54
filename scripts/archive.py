"""An archive's bar: so many simulated recordings, one of them torn, one worker killed in the middle. All but the torn one are done exactly once.

    .venv/bin/python scripts/archive.py [--recordings 200] [--workers 2] [--scaling]

With --scaling the same archive is worked through by one worker and by that many, without a kill, and the ratio is said: believe it where nothing else runs.
"""

from __future__ import annotations

import argparse
import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import distributed

import uwscan

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "fixtures/scenes"
#: Of a recording: few images of a small camera, so that hundreds are soon made.
WIDTH, HEIGHT, STEPS = 384, 288, 8


def simulate(folder: Path, number: int) -> None:
    """Recordings of a ball, each with noise of its own, in folders and files by turns; the last one torn."""
    folder.mkdir(parents=True)
    rig = (SCENES / "rig.toml").read_text()
    rig = rig.replace("width  = 768", f"width  = {WIDTH}").replace("height = 576", f"height = {HEIGHT}")
    # Half as many pixels, twice as large: the same view.
    rig = rig.replace("pixel_um = [8.6, 8.3]", "pixel_um = [17.2, 16.6]")
    (folder / "rig.toml").write_text(rig)
    scene = (SCENES / "ball.toml").read_text().replace("steps = 46", f"steps = {STEPS}")
    names = [f"dive-{k // 20:02}/{k:03}" + (".mcap" if k % 2 else "") for k in range(number)]
    for k, name in enumerate(names):
        (folder / "scene.toml").write_text(scene.replace("seed    = 3", f"seed    = {k + 1}"))
        path = folder / "archive" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        uwscan.simulate(folder / "scene.toml", output=path, progress=False)
    torn = folder / "archive" / names[-1]
    if torn.is_dir():
        (torn / "frames.csv").write_text("torn\n")
    else:
        torn.write_bytes(torn.read_bytes()[:300])


def calibrate(folder: Path) -> Path:
    """The calibration of an instrument with that camera: the fixtures' boards are another one's, so simulated ones are taken."""
    made = []
    for name in ("cal-air", "cal-water"):
        text = (ROOT / f"src/pipeline/demo/{name}.toml").read_text()
        (folder / f"{name}.toml").write_text(text)
        uwscan.simulate(folder / f"{name}.toml", output=folder / name, progress=False)
        made.append(folder / name)
    path = folder / "calibration.toml"
    uwscan.calibrate(made, progress=False).save(path)
    return path


def work(archive: Path, calibration: Path, output: Path, workers: int, kill_at: int | None) -> tuple[list[dict[str, Any]], bool, float]:
    """The rows, whether a worker was killed, and the seconds that it took, the cluster's start not counted."""
    killed = []
    with (
        distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.wait_for_workers(workers)

        def tell(stage: str, done: int, total: int) -> None:
            if kill_at is not None and done >= kill_at and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        began = time.monotonic()
        rows = uwscan.batch.run(archive, calibration=calibration, output=output, client=client, progress=tell)
        return rows, bool(killed), time.monotonic() - began


def check(rows: list[dict[str, Any]], output: Path, number: int) -> None:
    """All but the torn recording are done, each with one cloud and nothing left over."""
    status = {row["recording"]: row["status"] for row in rows}
    assert len(rows) == len(status) == number, f"{len(rows)} rows, {len(status)} recordings of {number}"
    failed = {name for name, s in status.items() if s == "failed"}
    assert len(failed) == 1, f"failed: {sorted(failed)}"
    assert all(s == "done" for name, s in status.items() if name not in failed), status
    clouds = sorted(output.rglob("*.ply"))
    assert len(clouds) == number - 1, f"{len(clouds)} clouds"
    assert all(row["points"] > 30 for row in rows if row["status"] == "done")
    table = (output / "table.csv").read_text().splitlines()
    assert len(table) == number + 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scaling", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        simulate(folder / "made", given.recordings)
        calibration = calibrate(folder / "made")
        archive = folder / "made/archive"
        print(f"{given.recordings} recordings of {STEPS} images, {WIDTH} x {HEIGHT} px, simulated in {time.monotonic() - began:.0f} s", flush=True)
        rows, killed, seconds = work(archive, calibration, folder / "out", given.workers, given.recordings // 3)
        assert killed, "the work was over before a worker could be killed"
        check(rows, folder / "out", given.recordings)
        print(f"one torn, one worker of {given.workers} killed: {given.recordings - 1} done exactly once in {seconds:.1f} s", flush=True)
        again, _, seconds = work(archive, calibration, folder / "out", given.workers, None)
        assert sum(not row["kept"] for row in again) == 1, "only what had failed is tried again"
        print(f"a second run: nothing done anew but the torn one, {seconds:.1f} s", flush=True)
        if given.scaling:
            times = [work(archive, calibration, folder / f"out-{n}", n, None)[2] for n in (1, given.workers)]
            print(f"one worker {times[0]:.1f} s, {given.workers} workers {times[1]:.1f} s: {times[0] / times[1]:.2f} times as fast; load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
