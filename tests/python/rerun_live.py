"""A running graph in rerun: a server of rerun receives it and stores what it received. Started by tests/tests/live.rs."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import pyarrow
from rerun.chunk import RrdReader

import panoscope as ps
from panoscope.rerun_live import show

FRAMES = 4
LIMIT = 300
GRAPH = """
mode = "live"
plugins = ["phantom", "stereo", "flow"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2, rate_hz = 10 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.end]
type = "drain"
inputs = { image = "scope.left" }
"""
PORTS = ["scope.left", "scope.detections", "scope.pose", "points.depth", "points.cloud"]


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def rows(path):
    """Rows by entity: tick and values by component."""
    found = {}
    for chunk in RrdReader(path).stream():
        if "tick" not in chunk.timeline_names:
            continue
        batch = chunk.to_record_batch()
        columns = {name: batch[name] for name in batch.schema.names if ":" in name or "." not in name and name != "log_time"}
        columns["capture"] = columns["capture"].cast(pyarrow.int64())
        values = [column.to_pylist() for column in columns.values()]
        found.setdefault(chunk.entity_path, []).extend(dict(zip(columns, row)) for row in zip(*values))
    return found


class RerunTest(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory(prefix="panoscope-rerun-")
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)
        self.graph = self.folder / "graph.toml"
        self.graph.write_text(GRAPH)

    def compare(self, file, recording):
        found = rows(file)
        for row in found["/scope/left"]:
            at = list(recording["scope.left"].capture_ns).index(row["capture"])
            wanted = recording["scope.left"][at]
            np.testing.assert_array_equal(np.array(row["Image:buffer"][0], "u1").reshape(wanted.shape), wanted)
        for row in found["/points/depth"]:
            wanted = recording["points.depth"][list(recording["points.depth"].capture_ns).index(row["capture"])]
            np.testing.assert_array_equal(np.array(row["DepthImage:buffer"][0], "u1").view("f4").reshape(wanted.shape), wanted)
        for row in found["/points/cloud"]:
            wanted = recording["points.cloud"][list(recording["points.cloud"].capture_ns).index(row["capture"])]
            known = wanted[np.isfinite(wanted["xyz_mm"]).all(axis=2) & (wanted["filled"] == 0)]
            np.testing.assert_allclose(row["Points3D:positions"], known["xyz_mm"] / 1000, rtol=1e-6)
        for row in found["/scope/detections"]:
            wanted = recording["scope.detections"][list(recording["scope.detections"].capture_ns).index(row["capture"])].boxes
            self.assertEqual(len(row["Boxes2D:labels"] or []), len(wanted))
        for row in found["/scope/pose"]:
            wanted = recording["scope.pose"][list(recording["scope.pose"].capture_ns).index(row["capture"])]
            np.testing.assert_allclose(row["Transform3D:translation"], [wanted["a_from_b_mm"] / 1000], rtol=1e-5, atol=1e-9)
        return {entity: len(of) for entity, of in found.items()}

    def test_a_server_of_rerun_receives_a_running_graph(self):
        port, file = free_port(), self.folder / "received.rrd"
        server = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", str(port), "--save", str(file)]
        # A job in the background of a shell ignores SIGINT, and hands that on.
        listens = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": {**os.environ, "RERUN": "on"}}
        process = subprocess.Popen(server, preexec_fn=listens, **quiet)
        self.addCleanup(process.kill)
        end = time.monotonic() + LIMIT
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                self.assertLess(time.monotonic(), end, "the server does not listen")
                self.assertIsNone(process.poll(), "the server ended")
                time.sleep(0.1)
        graph = ps.Graph(self.graph).record(self.folder / "run.mcap", all_ports=True)
        counts = show(graph, connect=f"rerun+http://127.0.0.1:{port}/proxy", ports=PORTS, frames=FRAMES)
        self.assertEqual(set(counts), set(PORTS))
        # The server stores what it has received until then when it ends.
        end, size = time.monotonic() + LIMIT, -1
        while time.monotonic() < end and (size <= 0 or size != file.stat().st_size):
            size = file.stat().st_size if file.exists() else 0
            time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        process.wait(LIMIT)
        received = self.compare(file, ps.Recording(self.folder / "run.mcap"))
        for port in PORTS:
            # Of a live graph the newest packets are shown: some may be left out.
            self.assertEqual(received["/" + port.replace(".", "/")], counts[port])
            self.assertGreater(counts[port], 0)

    def test_a_file_gets_all_outputs(self):
        graph = ps.Graph(self.graph).record(self.folder / "run.mcap", all_ports=True)
        counts = show(graph, save=self.folder / "run.rrd", frames=FRAMES)
        self.assertIn("scope.calibration", counts)
        self.assertIn("/scope/calibration/left", self.compare(self.folder / "run.rrd", ps.Recording(self.folder / "run.mcap")))

    def test_what_is_not_there_is_named(self):
        with self.assertRaisesRegex(ps.PanoscopeError, "no output `scope.lefft`"):
            show(ps.Graph(self.graph), save=self.folder / "run.rrd", ports=["scope.lefft"])
        words = [sys.executable, "-m", "panoscope.rerun_live", str(self.graph), "--save", str(self.folder / "c.rrd"), "--frames", "2"]
        done = subprocess.run([*words, "--port", "scope.left", "--set", "scope.rate_hz=20"], capture_output=True, text=True)
        self.assertEqual((done.returncode, done.stdout.split(":")[0]), (0, "scope.left"), done.stderr)
        done = subprocess.run([*words, "--set", "scope.rate_hz"], capture_output=True, text=True)
        self.assertEqual((done.returncode, "has no value" in done.stderr), (2, True))


if __name__ == "__main__":
    unittest.main()
