"""`panoscope run --foxglove`, spoken to by a WebSocket client. Started by tests/tests/live.rs; `PANOSCOPE_BIN` is the command."""

import base64
import io
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import foxglove.messages
import numpy as np
import PIL.Image
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
LIMIT = 300
GRAPH = """
name = "shown"
mode = "live"
plugins = ["phantom", "stereo", "flow"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2, rate_hz = 10 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.source]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 20 }
[nodes.level]
type = "level"
inputs = { image = "source.image" }
[nodes.end]
type = "drain"
inputs = { image = "source.image" }
[nodes.cloud_end]
type = "drain"
inputs = { image = "scope.left" }
"""
PRESET = """
[preset]
pinned = [{ param = "level.gain", range = [0.5, 2.0] }]
"""


class Run:
    """A running graph."""

    def __init__(self, *words, graph=GRAPH):
        self.holder = tempfile.TemporaryDirectory(prefix="panoscope-foxglove-")
        self.folder = Path(self.holder.name)
        (self.folder / "graph.toml").write_text(graph)
        self.recording = self.folder / "run.mcap"
        command = [COMMAND, "record", "graph.toml", "-o", self.recording, "--headless", "--all-ports", "--foxglove", "0", *words]
        self.process = subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.said = []
        for line in self.process.stderr:
            self.said.append(line)
            if line.startswith("serves ws://"):
                self.url = line.split()[1]
                return
        raise AssertionError("".join(self.said))

    def end(self):
        """Ends the run as Ctrl-C does; returns what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=LIMIT)
        return "".join(self.said) + err + out

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()
        self.holder.cleanup()


class Client:
    """Speaks Foxglove's protocol."""

    def __init__(self, url):
        self.socket = connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None, proxy=None, legacy=True, open_timeout=LIMIT)
        self.channels, self.values, self.errors, self.data, self.answers = {}, {}, [], {}, {}
        self.next = 0
        self.info = json.loads(self.socket.recv(timeout=LIMIT))
        self.until(lambda: len(self.channels) > 0)

    def step(self, timeout):
        """Takes one message."""
        try:
            message = self.socket.recv(timeout=timeout)
        except TimeoutError:
            return
        if isinstance(message, bytes):
            if message[0] == 1:
                subscription, log_time = struct.unpack_from("<IQ", message, 1)
                self.data.setdefault(subscription, []).append((log_time, message[13:]))
            return
        message = json.loads(message)
        if message["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in message["channels"]})
        elif message["op"] == "parameterValues":
            self.values.update({value["name"]: value.get("value") for value in message["parameters"]})
            self.answers[message.get("id")] = message["parameters"]
        elif message["op"] == "status":
            self.errors.append(message["message"])

    def until(self, condition):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, (self.errors, sorted(self.channels), self.values)
            self.step(0.2)

    def during(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.step(0.05)

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def subscribe(self, topic):
        self.until(lambda: topic in self.channels)
        self.next += 1
        self.send(op="subscribe", subscriptions=[{"id": self.next, "channelId": self.channels[topic]["id"]}])
        return self.next

    def messages(self, topic, count):
        """The first messages of a topic, decoded, with their times."""
        subscription, channel = self.subscribe(topic), self.channels[topic]
        self.until(lambda: len(self.data.get(subscription, [])) >= count)
        self.send(op="unsubscribe", subscriptionIds=[subscription])
        if channel["encoding"] == "json":
            return [(at, json.loads(data)) for at, data in self.data[subscription]]
        schema = Schema(id=1, name=channel["schemaName"], encoding="protobuf", data=base64.b64decode(channel["schema"]))
        decode = DecoderFactory().decoder_for("protobuf", schema)
        return [(at, decode(data)) for at, data in self.data[subscription]]

    def set(self, name, value, **more):
        self.next += 1
        key = f"set{self.next}"
        self.send(op="setParameters", id=key, parameters=[{"name": name, "value": value, **more}])
        self.until(lambda: key in self.answers)
        return self.answers[key]

    def close(self):
        self.socket.close()


class FoxgloveTest(unittest.TestCase):
    def run_graph(self, *words, **named):
        run = Run(*words, **named)
        self.addCleanup(run.close)
        return run

    def client(self, run):
        client = Client(run.url)
        self.addCleanup(client.close)
        return client

    def test_outputs_are_topics_with_their_values(self):
        run = self.run_graph()
        client = self.client(run)
        self.assertIn("shown", client.info["name"])
        client.until(lambda: {"/scope/left", "/points/cloud", "/scope/detections", "/scope/tip"} <= set(client.channels))
        for channel in client.channels.values():
            name = channel["schemaName"]
            if name.startswith("foxglove."):
                published = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
                self.assertEqual(base64.b64decode(channel["schema"]), published.data, name)
        left = client.messages("/scope/left", 4)
        small = client.messages("/scope/left/jpeg", 2)
        depth = client.messages("/points/depth", 3)
        cloud = client.messages("/points/cloud", 2)
        boxes = client.messages("/scope/detections", 2)
        camera = client.messages("/scope/calibration/left", 1)
        pose = client.messages("/scope/pose", 2)
        said = run.end()
        self.assertIn("0 faults", said)
        recording = ps.Recording(run.recording)

        def recorded(port, at):
            series = recording[port]
            return series[list(series.capture_ns).index(at)]

        for at, image in left:
            self.assertEqual((image.encoding, image.frame_id, image.step, image.timestamp.ToNanoseconds()), ("bgr8", "left", 480, at))
            np.testing.assert_array_equal(np.frombuffer(image.data, "u1").reshape(120, 160, 3), recorded("scope.left", at))
        for at, image in small:
            pixels = np.asarray(PIL.Image.open(io.BytesIO(image.data)))[:, :, ::-1].astype(int)
            self.assertEqual(image.format, "jpeg")
            self.assertLess(np.abs(pixels - recorded("scope.left", at)).mean(), 5)
        for at, image in depth:
            metres = np.frombuffer(image.data, "<f4").reshape(120, 160)
            np.testing.assert_array_equal(metres, recorded("points.depth", at) * np.float32(1e-3))
            self.assertTrue(0.01 < np.nanmedian(metres) < 0.2)
        for at, points in cloud:
            wanted = recorded("points.cloud", at)
            wanted = wanted[np.isfinite(wanted["xyz_mm"]).all(axis=2)]
            found = np.frombuffer(points.data, [("xyz", "<f4", 3), ("rgba", "u1", 4), ("filled", "u1")])
            np.testing.assert_allclose(found["xyz"], wanted["xyz_mm"] / 1000, rtol=1e-6)
            np.testing.assert_array_equal(found["filled"], wanted["filled"])
        for at, marks in boxes:
            wanted = recorded("scope.detections", at).boxes
            self.assertEqual(len(marks.points), len(wanted))
            for mark, box in zip(marks.points, wanted):
                self.assertAlmostEqual(mark.points[0].x, float(box["x_px"]), places=4)
        calibration = recording["scope.calibration"][0]
        self.assertEqual((camera[0][1].width, camera[0][1].K[0]), (160, calibration["left"]["fx"]))
        for at, found in pose:
            wanted = recorded("scope.pose", at)
            np.testing.assert_allclose(found.pose.position.x * 1000, wanted["a_from_b_mm"][0], rtol=1e-9, atol=1e-9)

    def test_only_what_is_subscribed_is_sent_and_costs(self):
        run = self.run_graph()
        client = self.client(run)
        client.until(lambda: "/scope/left" in client.channels)

        def spent():
            """Processor time of the thread that makes messages, in ticks of the system."""
            for task in Path(f"/proc/{run.process.pid}/task").iterdir():
                if (task / "comm").read_text().strip() == "foxglove-out":
                    fields = (task / "stat").read_text().rsplit(")", 1)[1].split()
                    return int(fields[11]) + int(fields[12])
            self.fail("the thread is missing")

        before = spent()
        client.during(1.5)
        self.assertEqual(client.data, {})
        self.assertLessEqual(spent() - before, 5)
        subscription = client.subscribe("/source/image")
        client.until(lambda: len(client.data.get(subscription, [])) > 5)
        self.assertEqual(set(client.data), {subscription})
        client.send(op="unsubscribe", subscriptionIds=[subscription])
        client.during(0.5)
        count = len(client.data[subscription])
        client.during(0.5)
        self.assertEqual(len(client.data[subscription]), count)

    def test_parameters_are_set_within_their_ranges(self):
        run = self.run_graph("--foxglove-set")
        client, other = self.client(run), self.client(run)
        self.assertIn("parameters", client.info["capabilities"])
        names = ["source.width_px", "level.gain"]
        client.send(op="getParameters", parameterNames=names, id="get")
        client.until(lambda: "get" in client.answers and client.values)
        while client.values.get("source.width_px") is None:
            client.send(op="getParameters", parameterNames=names, id="get")
            client.step(0.2)
        self.assertEqual((client.values["source.width_px"], client.values["level.gain"]), (64, 1.0))
        other.send(op="subscribeParameterUpdates", parameterNames=names)
        self.assertEqual(client.set("source.width_px", 96)[0]["value"], 96)
        subscription = client.subscribe("/source/image/jpeg")
        client.until(lambda: any(PIL.Image.open(io.BytesIO(data[data.index(b"\xff\xd8") :])).size == (96, 48) for _, data in client.data.get(subscription, [])))
        other.until(lambda: other.values.get("source.width_px") == 96)
        for name, value, words in (
            ("source.width_px", 99999, "outside 1 to 16384"),
            ("source.width_px", "wide", "another type"),
            ("source.width_px", 7.5, "another type"),
            ("source.none", 1, "no parameter"),
            ("nothing", 1, "no parameter"),
            ("source.pattern", "none such", "not one of"),
            ("level.gain", 1e300, "outside 0 to 8"),
        ):
            answer = client.set(name, value)
            client.until(lambda: any(words in error for error in client.errors))
            self.assertTrue(all(now["value"] in (96, "ramp", 1.0) for now in answer), answer)
            client.errors.clear()
        said = run.end()
        self.assertIn("foxglove: `source.width_px` was set", said)
        self.assertIn("`source.width_px` was not set: the value is outside 1 to 16384", said)

    def test_only_pins_of_a_preset_are_set(self):
        run = self.run_graph("--foxglove-set", graph=GRAPH + PRESET)
        client = self.client(run)
        client.until(lambda: "/level/image" in client.channels or "/source/image" in client.channels)
        self.assertEqual(client.set("level.gain", 1.5)[0]["value"], 1.5)
        for name, value, words in (("level.gain", 4.0, "outside 0.5 to 2, which `[preset]` allows"), ("source.width_px", 96, "does not pin it")):
            client.set(name, value)
            client.until(lambda: any(words in error for error in client.errors))

    def test_nothing_is_set_without_the_option(self):
        client = self.client(self.run_graph())
        client.set("source.width_px", 96)
        client.until(lambda: any("--foxglove-set" in error for error in client.errors))

    def test_malformed_messages_are_harmless(self):
        run = self.run_graph("--foxglove-set")
        client = self.client(run)
        for message in (
            "", "{", "[]", "null", '{"op":"subscribe"}', '{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1e99}]}',
            '{"op":"setParameters","parameters":[{"name":7}]}', '{"op":"setParameters","parameters":[{"name":"source.width_px"}],"id":"a"}',
            '{"op":"unsubscribe","subscriptionIds":[4711]}', '{"op":"advertise","channels":[]}', "x" * 100_000,
            '{"op":"setParameters","parameters":' + "[" * 5000 + "]" * 5000 + "}",
            b"", b"\x00", b"\x01\x02", b"\xff" * 1000, b"\x02" + b"\x00" * 3,
        ):  # fmt: skip
            try:
                client.socket.send(message)
            except ConnectionClosed:
                client = self.client(run)
        time.sleep(0.3)
        # The run goes on and serves others.
        self.assertGreaterEqual(len(self.client(run).messages("/source/image", 2)), 2)
        self.assertIsNone(run.process.poll())

    def test_pages_of_others_are_refused(self):
        run = self.run_graph()
        for origin in ("https://evil.example", "null", "http://10.0.0.2:8080"):
            with self.assertRaises(InvalidStatus) as refused:
                connect(run.url, subprotocols=["foxglove.sdk.v1"], origin=origin, proxy=None, legacy=True, open_timeout=LIMIT)
            self.assertEqual(refused.exception.response.status_code, 403)
            self.assertIn(b"may not connect", refused.exception.response.body)
        for origin in ("https://app.foxglove.dev", "http://localhost:8080"):
            connect(run.url, subprotocols=["foxglove.sdk.v1"], origin=origin, proxy=None, legacy=True, open_timeout=LIMIT).close()


if __name__ == "__main__":
    unittest.main()
