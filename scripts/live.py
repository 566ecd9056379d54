"""Reads both streams of a live scan with packages that are not ours: live.py UWSCAN VEHICLE CALIBRATION (see live.sh)."""

import asyncio
import base64
import json
import pathlib
import re
import struct
import subprocess
import sys
import tempfile

import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

TOPICS = {
    "/camera/image": "foxglove.CompressedImage",
    "/camera/stripe": "foxglove.ImageAnnotations",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/galvo/state": "uwscan.GalvoState",
    "/log": "foxglove.Log",
    "/scan/frame": "uwscan.Frame",
    "/scan/health": "uwscan.Health",
    "/scan/points": "foxglove.PointCloud",
    "/scan/profile": "uwscan.Profile",
    "/tf": "foxglove.FrameTransforms",
}


def decoder(channel):
    """The class of a channel's messages, from the schema that the server sends."""
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    left = list(files.file)
    while left:
        ready = [f for f in left if all(d not in [o.name for o in left] for d in f.dependency)]
        for file in ready:
            pool.Add(file)
            left.remove(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


async def foxglove(address, seen, parameters):
    """Subscribes to every topic, and decodes what comes until the server goes."""
    async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        assert socket.subprotocol == "foxglove.sdk.v1"
        classes = {}
        async for message in socket:
            if isinstance(message, str):
                said = json.loads(message)
                if said["op"] == "advertise":
                    for channel in said["channels"]:
                        assert TOPICS[channel["topic"]] == channel["schemaName"], channel["topic"]
                        classes[channel["id"]] = (channel["topic"], decoder(channel))
                    wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in said["channels"]]
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                elif said["op"] == "parameterValues":
                    parameters.update({p["name"]: p["value"] for p in said["parameters"]})
                continue
            opcode, subscription, _ = struct.unpack_from("<BIQ", message)
            if opcode == 1:
                topic, kind = classes[subscription]
                if topic == "/scan/points" and topic not in seen:
                    await socket.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "all"}))
                seen.setdefault(topic, []).append(kind.FromString(message[13:]))


async def page(address, seen):
    """Acknowledges, puts the cloud together, takes control, holds the scan and lets it go on."""
    async with websockets.connect(f"{address}/ws", subprotocols=["uwscan.live.v1"], max_size=None) as socket:
        await socket.send(json.dumps({"type": "hello", "token": None, "client": "live.py", "bandwidth_kbps": None}))
        steps = iter(["take-control", "pause", "resume"])
        asked = None
        async for message in socket:
            if isinstance(message, bytes):
                kind, sequence = message[0], struct.unpack_from("<I", message, 4)[0]
                await socket.send(json.dumps({"type": "ack", "sequence": sequence}))
                seen.setdefault(kind, []).append(message)
                if kind == 2:
                    epoch, first, count = struct.unpack_from("<IQI", message, 8)
                    if seen.get("epoch") != epoch:
                        seen["epoch"], seen["points"] = epoch, []
                    assert first == len(seen["points"]), (first, len(seen["points"]))
                    corner, step = struct.unpack_from("<3f", message, 24), struct.unpack_from("<f", message, 36)[0]
                    for i in range(count):
                        q = struct.unpack_from("<3H", message, 40 + 7 * i)
                        seen["points"].append(tuple(c + step * s for c, s in zip(corner, q)))
                continue
            said = json.loads(message)
            seen.setdefault(said["type"], []).append(said)
            if asked is None and said["type"] == "state" and said["phase"] == "scanning" and said["frames"] > 1:
                asked = next(steps)
            elif asked and said["type"] == "answer":
                assert said["ok"], (asked, said)
                asked = next(steps, "")
            else:
                continue
            if asked:
                if asked == "resume":
                    await asyncio.sleep(0.5)
                await socket.send(json.dumps({"type": "command", "id": 1, "do": asked}))


async def main(binary, vehicle, calibration):
    folder = pathlib.Path(tempfile.mkdtemp())
    target = folder / "live.mcap"
    command = [binary, "scan", "--config", vehicle, "-c", calibration, "-o", target, "--repeat", "5", "--json"]
    scan = await asyncio.create_subprocess_exec(
        *command, "--live", "127.0.0.1:0", stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    addresses = []
    while len(addresses) < 2:
        line = (await scan.stderr.readline()).decode()
        assert line, "the scan said no address"
        addresses += re.findall(r"^live: (?:http|ws)://([^/ ]+)", line)
    streamed, shown, parameters = {}, {}, {}

    async def until_gone(reading):
        try:
            await reading
        except websockets.ConnectionClosed:
            pass

    reading = [
        asyncio.create_task(until_gone(foxglove(f"ws://{addresses[1]}", streamed, parameters))),
        asyncio.create_task(until_gone(page(f"ws://{addresses[0]}", shown))),
    ]
    out, errors = await scan.communicate()
    await asyncio.gather(*reading)
    assert scan.returncode == 0, errors.decode()
    report = json.loads(out)

    missing = set(TOPICS) - set(streamed)
    assert not missing, f"nothing came on {missing}"
    image = streamed["/camera/image"][-1]
    assert image.format == "jpeg" and image.data[:2] == b"\xff\xd8", image.format
    health = streamed["/scan/health"][-1]
    assert health.frames <= report["frames"] and health.laser in ("on", "off"), health
    clouds = streamed["/scan/points"]
    assert any(cloud.data for cloud in clouds) and clouds[0].point_stride > 24
    assert parameters["planned"] == report["planned"], parameters
    # Metres there, millimetres here: the page's points are the stream's.
    first = next(cloud for cloud in clouds if cloud.data)
    here = {tuple(round(x, 1) for x in point) for point in shown["points"]}
    x, y, z = (1e3 * v for v in struct.unpack_from("<3d", first.data))
    near = [(round(x + i, 1), round(y + j, 1), round(z + k, 1)) for i in (0, 0.1, -0.1) for j in (0, 0.1, -0.1) for k in (0, 0.1, -0.1)]
    assert any(point in here for point in near), (x, y, z)
    assert len(shown["points"]) == report["on_the_fly"]["points"], (len(shown["points"]), report["on_the_fly"])
    phases = [state["phase"] for state in shown["state"]]
    assert "paused" in phases and phases[-1] == "finished", phases
    assert {1, 2, 3} <= set(shown), set(shown)
    counts = ", ".join(f"{topic} {len(streamed[topic])}" for topic in sorted(streamed))
    print(f"Foxglove's stream, decoded by its own schemas: {counts}")
    print(f"the page's: {len(shown[1])} images, {len(shown['points'])} points, as many as on the fly; held and resumed")


asyncio.run(main(*sys.argv[1:]))
