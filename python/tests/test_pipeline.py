"""Captures, calibration, reconstruction: every line of the promised surface, and the command's own results."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from helpers import FIXTURES

import uwscan

#: The ball's true radius (fixtures/truth.csv), and how far a fit may be off, mm.
BALL_MM, BALL_OFF_MM = 20.0175, 0.03


def test_a_capture_is_a_sequence_of_frames():
    with uwscan.open_capture(FIXTURES / "cal-water") as capture:
        assert (capture.kind, capture.medium, len(capture)) == ("calibration", "water", 70)
        frames = list(capture)
        assert [f.index for f in frames] == list(range(70))
        assert sum(f.laser_on for f in frames) == 60
        lit = next(f for f in frames if f.laser_on)
        assert lit.image.shape == (576, 768) and lit.image.dtype == np.uint8
        assert lit.image is lit.image, "decoded once"
        assert isinstance(lit.voltage_v, float) and lit.pose is not None and lit.stamp_ns > 0
        assert capture[-1].file == frames[-1].file
        with pytest.raises(IndexError):
            capture[70]
        assert len(capture.content_hash()) == 64
        kept = frames[0]
    with pytest.raises(uwscan.InputError, match="closed"):
        len(capture)
    with pytest.raises(uwscan.InputError, match="closed"):
        uwscan.reconstruct(capture, "calibration.toml")
    assert kept.image.shape == (576, 768), "a frame outlives its capture"


def test_calibration_has_the_promised_figures(calibration, calibration_file):
    assert calibration.camera_matrix.shape == (3, 3) and calibration.camera_matrix[2].tolist() == [0, 0, 1]
    assert calibration.distortion.shape == (5,)
    assert abs(np.linalg.norm(calibration.axis_direction) - 1) < 1e-12
    assert calibration.axis_point_mm.shape == (3,)
    assert calibration.covariance.shape == (34, 34) == (len(calibration.covariance_names),) * 2
    np.testing.assert_allclose(calibration.covariance, calibration.covariance.T)
    assert calibration.sigmas.keys() == calibration.values.keys() and 0 < calibration.sigmas["camera.fx_px"] < 1
    np.testing.assert_allclose(calibration.sigmas["camera.fx_px"] ** 2, calibration.covariance[0, 0])
    assert calibration.values["camera.fx_px"] == calibration.camera_matrix[0, 0]
    assert (calibration.method, calibration.axis, calibration.image_size) == ("joint", "rows", (768, 576))
    assert 1.33 < calibration.water_index() < 1.34
    frame = calibration.camera_from_galvo
    np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame[:3, 3], calibration.axis_point_mm)
    again = uwscan.Calibration.load(calibration_file)
    np.testing.assert_array_equal(again.camera_matrix, calibration.camera_matrix)
    np.testing.assert_array_equal(again.covariance, calibration.covariance)


def test_calibration_leaves_a_report(calibration, calibration_page, tmp_path):
    if not calibration_page.exists():
        pytest.skip("UWSCAN_CALIBRATION names a calibration that was made before")
    page = calibration_page.read_text()
    assert "one fine day" in page and "<svg" in page
    assert json.loads(calibration_page.with_suffix(".json").read_text())["reprojection_rms_px"] > 0
    # What stands in the way is told before any work is done: there are no such captures.
    with pytest.raises(uwscan.ExistingFileError):
        uwscan.calibrate("nowhere", report=calibration_page)
    with pytest.raises(uwscan.MissingFileError):
        uwscan.calibrate("nowhere", report=calibration_page, overwrite=True)
    with pytest.raises(uwscan.InputError, match="html"):
        uwscan.calibrate("nowhere", report=tmp_path / "page.pdf")


def test_reconstruct_gives_the_balls_radius(cloud, calibration, tmp_path):
    n = len(cloud)
    assert cloud.points_mm.shape == (n, 3) and cloud.points_mm.dtype == np.float64
    assert cloud.pixel.shape == (n, 2) and cloud.frame_index.dtype == np.uint32
    assert cloud.covariance_mm2.shape == (n, 3, 3) and cloud.intensity.shape == cloud.sigma_mm.shape == (n,)
    widest = np.linalg.eigvalsh(cloud.covariance_mm2.astype(float))[:, -1]
    np.testing.assert_allclose(np.sqrt(widest), cloud.sigma_mm, rtol=1e-3)
    assert not cloud.points_mm.flags.writeable and np.shares_memory(cloud.points_mm, cloud.points_mm)
    assert cloud.report["frames"] == 43 and cloud.report["rejected"]["no_signal"] > 0
    fit = uwscan.fit_sphere(cloud, calibration=calibration)
    assert abs(fit.radius_mm - BALL_MM) < BALL_OFF_MM
    assert fit.sigma_total_radius_mm > fit.sigma_radius_mm > 0
    assert fit.sigma_total_center_mm.shape == (3,) and fit.covariance_total.shape == (4, 4)
    cloud.save(tmp_path / "ball.ply")
    again = uwscan.Cloud.load(tmp_path / "ball.ply")
    np.testing.assert_array_equal(again.points_mm, cloud.points_mm)
    np.testing.assert_array_equal(again.covariance_mm2, cloud.covariance_mm2)


def test_the_command_writes_the_same_bytes(binary, cloud, calibration_file, tmp_path):
    subprocess.run(
        [binary, "reconstruct", FIXTURES / "ball", "-c", calibration_file, "-o", tmp_path / "command.ply", "-q"], check=True
    )
    cloud.save(tmp_path / "python.ply")
    assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "command.ply").read_bytes()


def test_threads_do_not_change_a_cloud(cloud, calibration):
    one = uwscan.reconstruct(FIXTURES / "ball", calibration, threads=1)
    np.testing.assert_array_equal(one.points_mm, cloud.points_mm)


def test_frames_and_refraction(cloud, calibration):
    galvo = uwscan.reconstruct(FIXTURES / "ball", calibration, frame="galvo")
    assert galvo.frame == "galvo"
    back = galvo.points_mm @ calibration.camera_from_galvo[:3, :3].T + calibration.camera_from_galvo[:3, 3]
    np.testing.assert_allclose(back, cloud.points_mm, atol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", uwscan.UwscanWarning)
        straight = uwscan.reconstruct(FIXTURES / "ball", calibration, refraction="none")
    assert abs(uwscan.fit_sphere(straight).radius_mm - BALL_MM) > 1


def test_the_model_is_the_one_that_made_the_cloud(cloud, calibration):
    scanner, index = calibration.scanner, cloud.report["index"]
    frames = list(uwscan.open_capture(FIXTURES / "ball"))
    voltages = np.array([frames[i].voltage_v for i in cloud.frame_index])
    points = scanner.triangulate(cloud.pixel, voltages, index=index)
    # Pixels are stored in 32 bits.
    np.testing.assert_allclose(points, cloud.points_mm, atol=2e-4)
    np.testing.assert_allclose(scanner.project(points, index=index), cloud.pixel, atol=1e-9)
    assert np.max(np.abs(scanner.off_sheet(points, voltages, index=index))) < 1e-12
    _, per_u, _, _ = scanner.triangulate_with_derivatives(cloud.pixel, voltages, index=index)
    moved = scanner.triangulate(cloud.pixel + [1e-4, 0], voltages, index=index) - points
    np.testing.assert_allclose(moved / 1e-4, per_u, rtol=1e-3, atol=1e-4)
    rebuilt = uwscan.Scanner(scanner.camera, scanner.camera_port, scanner.galvo, scanner.fan, scanner.laser_port)
    np.testing.assert_array_equal(rebuilt.triangulate(cloud.pixel, voltages, index=index), points)
    origins, directions = scanner.back_project(cloud.pixel, index=index)
    off = np.cross(points - origins, directions)
    assert np.max(np.linalg.norm(off, axis=1)) < 1e-9


def test_progress_is_told_from_the_calling_thread(calibration):
    told = []
    caller = threading.get_ident()

    def tell(stage, done, total):
        assert threading.get_ident() == caller
        told.append((stage, done, total))

    uwscan.reconstruct(FIXTURES / "ball", calibration, progress=tell)
    assert told[-1] == ("frames", 43, 43)
    assert all(a[1] <= b[1] for a, b in zip(told, told[1:], strict=False))


def test_what_progress_raises_ends_the_call(calibration):
    def tell(stage, done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        uwscan.reconstruct(FIXTURES / "ball", calibration, progress=tell)


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal")
def test_ctrl_c_ends_a_long_call():
    # Whoever starts programs in the background may have had them ignore it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            for _ in range(100):
                uwscan.calibrate(FIXTURES / "cal-air")
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)


def test_other_threads_run_meanwhile(calibration):
    counted, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0)

    thread = threading.Thread(target=count)
    thread.start()
    uwscan.reconstruct(FIXTURES / "ball", calibration, threads=1)
    stop.set()
    thread.join()
    assert counted[0] > 100


def test_simulate_makes_a_capture_and_its_truth(tmp_path):
    text = (FIXTURES / "scenes" / "ball.toml").read_text().replace("steps = 46", "steps = 3")
    scene = FIXTURES / "scenes" / "ball.toml"
    short = tmp_path / "short.toml"
    short.write_text(text)
    truth = uwscan.simulate(short, FIXTURES / "scenes" / "rig.toml", output=tmp_path / "scan")
    assert (truth / "truth.json").is_file() and (truth / "stripes.csv").is_file()
    with uwscan.open_capture(tmp_path / "scan") as capture:
        assert (capture.kind, len(capture)) == ("scan", 3)
    with pytest.raises(uwscan.ExistingFileError):
        uwscan.simulate(short, FIXTURES / "scenes" / "rig.toml", output=tmp_path / "scan")
    with pytest.raises(uwscan.MissingFileError):
        uwscan.simulate(tmp_path / "none.toml", output=tmp_path / "other")
    with pytest.raises(uwscan.MissingFileError):
        uwscan.simulate(scene, tmp_path / "none.toml", output=tmp_path / "other")


def test_a_lost_image_is_warned_of(calibration, tmp_path):
    import shutil

    shutil.copytree(FIXTURES / "ball", tmp_path / "ball")
    with uwscan.open_capture(tmp_path / "ball") as capture:
        (tmp_path / "ball" / capture[20].file).unlink()
    with pytest.warns(uwscan.LossWarning):
        cloud = uwscan.reconstruct(tmp_path / "ball", calibration)
    assert len(cloud.report["lost"]) == 1 and cloud.report["frames"] == 42


def test_errors_are_of_their_kind_with_the_commands_words(calibration, calibration_file, tmp_path):
    with pytest.raises(uwscan.MissingFileError, match="check the path") as e:
        uwscan.open_capture(tmp_path / "none")
    assert isinstance(e.value, FileNotFoundError) and e.value.errno == 2 and e.value.filename == str(tmp_path / "none")
    assert str(e.value).startswith(str(tmp_path / "none"))
    (tmp_path / "bad.toml").write_text("format = \"uwscan-rig\"\n")
    with pytest.raises(uwscan.FormatError, match="uwscan-calibration") as e:
        uwscan.Calibration.load(tmp_path / "bad.toml")
    assert isinstance(e.value, ValueError)
    with pytest.raises(uwscan.ExistingFileError) as e:
        calibration.save(calibration_file)
    assert isinstance(e.value, FileExistsError)
    calibration.save(calibration_file, overwrite=True)
    with pytest.raises(uwscan.CaptureError, match="a scan is needed here"):
        uwscan.reconstruct(FIXTURES / "cal-air", calibration)
    with pytest.raises(uwscan.CaptureError, match="the same capture"):
        uwscan.calibrate([FIXTURES / "cal-air", FIXTURES / "cal-air"])
    with pytest.raises(uwscan.CalibrationError):
        uwscan.calibrate([])
    for e_class in [uwscan.CaptureError, uwscan.FitError, uwscan.FileError, uwscan.DtypeError]:
        again = pickle.loads(pickle.dumps(e_class("what, where, and the mend")))
        assert type(again) is e_class and str(again) == "what, where, and the mend"


@pytest.mark.parametrize(
    "settings",
    [
        {"refraction": "bent"},
        {"frame": "world"},
        {"stripe": "best"},
        {"medium": "oil"},
        {"water_index": 0.5},
        {"water_index": 1.33, "water": (10.0, 35.0, 0.0)},
        {"water": (float("nan"), 35.0, 0.0)},
        {"threads": 0},
        {"threads": 10**6},
        {"progress": 5},
    ],
)
def test_settings_that_can_not_be_are_refused(settings, calibration):
    with pytest.raises(uwscan.InputError):
        uwscan.reconstruct(FIXTURES / "ball", calibration, **settings)


@pytest.mark.parametrize("capture", [None, 5, object(), np.zeros(3)])
def test_what_is_no_capture_is_refused(capture, calibration):
    with pytest.raises((uwscan.InputError, uwscan.FileError)):
        uwscan.reconstruct(capture, calibration)
    with pytest.raises((uwscan.InputError, uwscan.FileError)):
        uwscan.reconstruct(FIXTURES / "ball", capture)


def test_water_index_broadcasts():
    assert uwscan.water_index(20.0, 35.0, 532.0) == uwscan.water_index(20.0, 35.0, 532.0, 0.0) < uwscan.water_index(20.0, 35.0, 532.0, 100)
    with pytest.raises(uwscan.UwscanError):
        uwscan.water_index(20.0, 35.0, 532.0, None)
    assert abs(uwscan.water_index(20.0, 35.0, 532.0) - 1.341510) < 1e-6
    grid = uwscan.water_index(np.array([[4.0], [20.0]]), [0.0, 35.0], 532.0, depth_m=10)
    assert grid.shape == (2, 2) and abs(grid[1, 1] - 1.341510 - 1.48e-5) < 1e-6
    for bad in ["warm", [1 + 2j], [None]]:
        with pytest.raises(uwscan.InputError):
            uwscan.water_index(bad, 35.0, 532.0)
    with pytest.raises(uwscan.InputError):
        uwscan.water_index([1.0, 2.0], [1.0, 2.0, 3.0], 532.0)
