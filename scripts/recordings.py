"""Reads recordings with packages that are not ours: recordings.py RECORDING CONVERTED BAG OTHER… (see recordings.sh)."""

import io
import pathlib
import subprocess
import sys

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

TOPICS = {
    "/camera/image": "foxglove.RawImage",
    "/environment": "uwscan.Environment",
    "/galvo/state": "uwscan.GalvoState",
    "/log": "foxglove.Log",
    "/nav/pose": "foxglove.PoseInFrame",
    "/scan/frame": "uwscan.Frame",
    "/scan/points": "foxglove.PointCloud",
    "/scan/profile": "uwscan.Profile",
    "/tf": "foxglove.FrameTransforms",
}


def ns(stamp):
    return stamp.seconds * 1_000_000_000 + stamp.nanos


def written_by_the_example(path):
    seen = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        head = {m.name: m.metadata for m in reader.iter_metadata()}["uwscan"]
        assert (head["format"], head["kind"], head["medium"]) == ("uwscan-recording", "scan", "water"), head
        calibrated = "calibration.toml" in [a.name for a in reader.iter_attachments()]
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            n = seen[channel.topic] = seen.get(channel.topic, -1) + 1
            expected = TOPICS | {"/camera/calibration": "foxglove.CameraCalibration"}
            assert schema.name == expected[channel.topic], (schema.name, channel.topic)
            began = 1_700_000_000_000_000_000 + n * 10_000_000
            if channel.topic == "/camera/image":
                assert (message.sequence, message.publish_time, message.log_time) == (n, began, began + 4_000_000)
                assert (decoded.width, decoded.height, decoded.step, decoded.encoding) == (64, 48, 128, "mono16")
                assert ns(decoded.timestamp) == began and decoded.frame_id == "camera"
                pixels = np.frombuffer(decoded.data, "<u2").reshape(decoded.height, decoded.step // 2)
                v, u = np.mgrid[:48, :64]
                assert (pixels == n + u + 64 * v).all()
            elif channel.topic == "/scan/frame":
                assert (decoded.frame, decoded.voltage_v, decoded.bits) == (n, 0.25 * n, 12)
                assert decoded.laser_on and not decoded.HasField("pose") and ns(decoded.timestamp) == began
            elif channel.topic == "/galvo/state":
                assert (decoded.commanded_v, decoded.readback_v, decoded.settled) == (0.25 * n, 0.25 * n + 1e-3, True)
            elif channel.topic == "/scan/profile":
                assert list(decoded.position_px) == [31.25 + 0.25 * n, 31.5 + 0.25 * n] and list(decoded.line) == [3, 4]
            elif channel.topic == "/scan/points":
                kinds = {7: "<f4", 8: "<f8", 5: "<u4"}
                fields = decoded.fields
                layout = {
                    "names": [f.name for f in fields],
                    "formats": [kinds[f.type] for f in fields],
                    "offsets": [f.offset for f in fields],
                    "itemsize": decoded.point_stride,
                }
                (point,) = np.frombuffer(decoded.data, np.dtype(layout))
                where = [point["x"], point["y"], point["z"]]
                assert np.allclose(where, [1.5e-3, -2.5e-3, 1.0 + n * 1e-3], rtol=0, atol=1e-12), "metres"
                assert point["frame"] == n and abs(point["sigma"] - 2e-5) < 1e-9
            elif channel.topic == "/environment":
                assert (decoded.temperature_c, decoded.index) == (12.0, 1.3351)
            elif channel.topic == "/camera/calibration":
                assert decoded.distortion_model == "plumb_bob" and len(decoded.D) == 5 and decoded.K[8] == 1.0
    counts = {topic: n + 1 for topic, n in seen.items()}
    wanted = set(TOPICS) | ({"/camera/calibration"} if calibrated else set())
    assert set(counts) == wanted, counts
    assert counts["/camera/image"] == counts["/scan/frame"] == counts["/scan/points"] == 20, counts
    print("mcap:", ", ".join(f"{topic} {count}" for topic, count in sorted(counts.items())))


def converted(path):
    images = 0
    with open(path, "rb") as file:
        for _, _, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics=["/camera/image"]
        ):
            image = np.asarray(Image.open(io.BytesIO(decoded.data)))
            assert decoded.format == "png" and image.ndim == 2 and image.size > 0
            images += 1
    assert images > 0
    print(f"mcap: {images} PNG images of {image.shape[1]} x {image.shape[0]} px, {image.dtype}, decoded by Pillow")


def doctor(path):
    run = subprocess.run(["pymcap-cli", "doctor", path], capture_output=True, text=True)
    said = (run.stdout + run.stderr).strip()
    assert run.returncode == 0, said
    print(f"pymcap-cli doctor {path.rsplit('/', 1)[-1]}:", said.splitlines()[-1] if said else "nothing to say")


def bag(folder):
    counts = {}
    with AnyReader([pathlib.Path(folder)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, time, raw in reader.messages():
            n = counts[connection.topic] = counts.get(connection.topic, -1) + 1
            decoded = reader.deserialize(raw, connection.msgtype)
            began = 1_700_000_000_000_000_000 + n * 10_000_000
            if connection.topic == "/camera/image":
                stamp = decoded.header.stamp
                assert time == began == stamp.sec * 1_000_000_000 + stamp.nanosec
                assert (decoded.width, decoded.height, decoded.step, decoded.encoding) == (64, 48, 128, "mono16")
                v, u = np.mgrid[:48, :64]
                assert (decoded.data.view("<u2").reshape(48, 64) == n + u + 64 * v).all()
            elif connection.topic == "/galvo/voltage":
                assert decoded.data == 0.25 * n
            elif connection.topic == "/scan/points":
                x, y, z = np.frombuffer(decoded.data.tobytes()[:24], "<f8")
                assert np.allclose([x, y, z], [1.5e-3, -2.5e-3, 1.0 + n * 1e-3], rtol=0, atol=1e-12)
                kinds = [(field.name, field.datatype) for field in decoded.fields]
                assert kinds[:5] == [("x", 8), ("y", 8), ("z", 8), ("intensity", 7), ("frame", 6)], kinds
            elif connection.topic == "/camera/camera_info":
                assert decoded.distortion_model == "plumb_bob" and decoded.k[8] == decoded.r[0] == decoded.p[10] == 1.0
            elif connection.topic == "/nav/pose":
                assert decoded.pose.position.x == n and decoded.pose.orientation.w == 1.0
    counts = {topic: n + 1 for topic, n in counts.items()}
    assert counts["/camera/image"] == counts["/galvo/voltage"] == counts["/scan/points"] == counts["/nav/pose"] == 20
    assert "/tf" in counts
    print("rosbags:", ", ".join(f"{topic} {count}" for topic, count in sorted(counts.items())))


example, capture, ros2, *others = sys.argv[1:]
written_by_the_example(example)
converted(capture)
bag(ros2)
for path in [example, capture, f"{ros2}/recording.mcap", *others]:
    doctor(path)
