"""Graphs and recordings from Python. Started by tests/tests/python_host.rs, each class by itself; `PANOSCOPE_BIN` is the command that results are
compared with."""

import gc
import json
import os
import re
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import zlib
from pathlib import Path
from typing import Optional

import numpy as np

import panoscope as ps
from panoscope import testing as ps_testing

COMMAND = os.environ["PANOSCOPE_BIN"]
ROOT = Path(__file__).resolve().parents[2]
FRAMES = 8

GRAPH = """
mode = "batch"
plugins = ["phantom", "stitch", "stereo", "overlay", "flow"]
[args.seed]
type = "whole"
default = 7
doc = "Seed"
[nodes.scope]
type = "phantom"
params = { width = 320, height = 240, seed = { arg = "seed" } }
[nodes.register]
type = "register_surf"
inputs = { left = "scope.left", right = "scope.right" }
[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "rectify.left", right = "rectify.right" }
[nodes.points]
type = "reproject"
inputs = { image = "rectify.left", disparity = "match.disparity", calibration = "rectify.calibration" }
[nodes.marks]
type = "overlay"
inputs = { image = "scope.left", homography = "register.homography", roi = "register.roi_left", depth = "points.depth" }
[nodes.ends]
type = "drain"
inputs = { image = "marks.image" }
"""
WATCH = [
    "scope.left", "scope.calibration", "rectify.left", "register.homography", "register.roi_left", "match.disparity", "points.depth",
]  # fmt: skip

PYTHON_NODE = '''
import os, ctypes
import numpy as np
import panoscope as ps

@ps.node()
class Invert:
    def process(self, image: ps.Gray8) -> ps.Gray8:
        return 255 - image

@ps.node()
class Fails:
    def process(self, image: ps.Gray8) -> ps.Gray8:
        raise ValueError("never works")
'''


def command(*words):
    """Runs the command; its output is shown when it fails."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True)
    assert done.returncode == 0, f"{words}: {done.stdout}\n{done.stderr}"


def chunk(png, name):
    """A chunk of a PNG file; its check sum is compared."""
    at = png.index(name)
    (length,) = struct.unpack(">I", png[at - 4 : at])
    (check,) = struct.unpack(">I", png[at + 4 + length : at + 8 + length])
    assert check == zlib.crc32(png[at : at + 4 + length])
    return png[at + 4 : at + 4 + length]


def read_png(file):
    """Height and width of a PNG file."""
    width, height = struct.unpack(">II", chunk(file.read_bytes(), b"IHDR")[:8])
    return height, width


def settled(read, limit_s=60):
    """A count once it has begun and has not changed for 0.3 s."""
    end, last, since = time.monotonic() + limit_s, 0, time.monotonic()
    while last == 0 or time.monotonic() < since + 0.3:
        assert time.monotonic() < end, f"it does not come to rest: {last}"
        time.sleep(0.02)
        now = read()
        if now != last:
            last, since = now, time.monotonic()
    return last


class HostCase(unittest.TestCase):
    """A folder for each test, and graphs in it."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="panoscope-host-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def graph(self, text=GRAPH, **options):
        file = self.folder / "graph.toml"
        file.write_text(text)
        return ps.Graph(file, **options)

    def recorded(self, path, *words):
        """What the command records of a graph: the recording, and the fingerprints by port and tick."""
        recording, digests = self.folder / "command.mcap", self.folder / "command.json"
        command("record", path, "-o", recording, "--all-ports", "--digests", digests, "--headless", *words)
        ports = json.loads(digests.read_text())["ports"]
        return ps.Recording(recording), {port: {seq: hash for _, seq, hash in of["packets"]} for port, of in ports.items()}

    def assert_same(self, result, recording, digests, output, port):
        series = result[output]
        self.assertEqual({packet.tick: packet.fingerprint for packet in series.packets()}, digests[port], output)
        for mine, theirs in zip(series.packets(), recording[port].packets()):
            self.assertEqual((mine.tick, mine.capture_ns), (theirs.tick, theirs.capture_ns))
            if isinstance(mine.value, np.ndarray) and mine.value.dtype.names is None:
                np.testing.assert_array_equal(mine.value, theirs.value)
            self.assertEqual(type(mine.value), type(theirs.value))
            self.assertEqual(mine.fingerprint, theirs.fingerprint)


class CommandTest(HostCase):
    """Graphs give what the command gives; mistakes and changes of them."""

    def test_arrays_are_those_of_the_command(self):
        graph = self.graph(args=["--seed=9"])
        result = graph.run(frames=FRAMES, watch=[*WATCH, "points.cloud", "scope.detections"])
        recording, digests = self.recorded(graph.path, "--frames", FRAMES, "--seed", 9)
        for output in WATCH:
            self.assertEqual(len(result[output]), FRAMES, output)
            self.assert_same(result, recording, digests, output, output)
        self.assertEqual(list(result["scope.left"].ticks), list(range(FRAMES)))
        self.assertEqual(result["scope.left"].stack().shape, (FRAMES, 240, 320, 3))
        cloud = result["points.cloud"][0]
        measured = np.where(cloud["filled"] == 0, cloud["xyz_mm"][:, :, 2], np.nan)
        np.testing.assert_array_equal(measured, result["points.depth"][0])
        self.assertTrue(np.isfinite(cloud["xyz_mm"][cloud["filled"] != 0]).all() and (cloud["filled"] <= 1).all())
        self.assertGreater(len(result["scope.detections"][0].labels), 0)
        self.assertEqual(result["register.homography"][0].left_from_right.shape, (3, 3))
        self.assertTrue(np.isfinite(result["match.disparity"].ages_ms).all())
        other = self.graph(args={"seed": 10}).run(frames=1, watch=["scope.left"])
        self.assertNotEqual(other["scope.left"].packet(0).fingerprint, result["scope.left"].packet(0).fingerprint)
        # Bytes that Python changes have another fingerprint: it is of what the array shows.
        packet = result["scope.left"].packet(0)
        before = packet.fingerprint
        packet.value[0, 0, 0] ^= 1
        self.assertNotEqual(packet.fingerprint, before)

    def test_a_graph_of_parts_is_that_of_the_command(self):
        graph = ps.Graph(ROOT / "graphs" / "panorama.toml")
        result = graph.run(frames=FRAMES, watch=["wide.panorama"])
        os.chdir(self.folder)
        recording, digests = self.recorded(graph.path, "--frames", FRAMES, "--unpaced")
        self.assert_same(result, recording, digests, "wide.panorama", "wide/composite.panorama")
        self.assertEqual(set(result.report["nodes"]), {"scope", "wide/register", "wide/composite"}, "nothing is written")

    def test_mistakes_have_a_place_and_a_remedy(self):
        with self.assertRaises(ps.GraphError) as raised:
            self.graph(GRAPH.replace("seed = {", "seeed = {")).check()
        mistake = next(mistake for mistake in raised.exception.diagnostics if mistake.severity == "error")
        self.assertEqual((mistake.code, mistake.label), ("unknown-param", "did you mean `seed`?"))
        self.assertEqual(GRAPH.replace("seed = {", "seeed = {").splitlines()[mistake.line - 1][mistake.column - 1 :][:5], "seeed")
        self.assertIn("graph.toml:", str(raised.exception))
        graph = self.graph()
        for output, words in (("scop.left", "nodes and parts are scope"), ("scope.lefft", "scope.left, scope.right"), ("scope", "scope.left")):
            with self.assertRaisesRegex(ps.GraphError, words):
                graph.run(frames=1, watch=[output])
        with self.assertRaisesRegex(ps.GraphError, "no argument `--sed=3`"):
            self.graph(args=["--sed=3"])
        with self.assertRaises(ps.GraphError):
            ps.check(self.folder / "no_such_file.toml")
        with self.assertRaisesRegex(ps.RecordingError, "is not a recording"):
            ps.Recording(graph.path)
        self.assertEqual(graph.check(), [])

    def test_parameters_and_text_change_while_the_graph_runs(self):
        text = GRAPH.replace('mode = "batch"', 'mode = "live"')
        graph = self.graph(text, set={"scope.noise": 1.5})
        self.assertEqual(graph.get("scope.noise"), 1.5)
        with graph.start(watch=["scope.left", "marks.image"], act=True) as running:
            packets = iter(running)
            next(packets)
            self.assertEqual(graph.get("scope.noise"), 1.5)
            graph.set("scope.noise", 0.5)
            self.assertEqual((running.get("scope.noise"), graph.get("scope.noise")), (0.5, 0.5))
            self.assertIn("noise = 0.5", running.text)
            with self.assertRaises(ps.GraphError):
                running.set("scope.noise", "much")
            with self.assertRaisesRegex(ps.EditError, "no_such_param"):
                running.get("scope.no_such_param")
            changed = running.apply(running.text + '\n[nodes.more]\ntype = "pass"\ninputs = { image = "scope.left" }\n')
            self.assertIn("more", changed)
            with self.assertRaises(ps.GraphError):
                running.apply(running.text.replace('"phantom"', '"fantom"'))
            next(packets)
        with self.assertRaises(ps.EditError):
            self.graph(text).apply(text)


class RunTest(HostCase):
    """Recordings, processes, readers and threads."""

    def test_a_recording_is_read_and_played_again(self):
        graph = self.graph()
        file = self.folder / "mine.mcap"
        result = graph.record(file, all_ports=True).run(frames=FRAMES, watch=["match.disparity", "scope.left"])
        recording = ps.Recording(file)
        self.assertEqual(len(recording["scope.left"]), FRAMES)
        np.testing.assert_array_equal(recording["scope.left"][3], result["scope.left"][3])
        np.testing.assert_array_equal(recording["match.disparity"][2:6].stack(), result["match.disparity"].stack()[2:6])
        np.testing.assert_array_equal(recording["scope.left"][-1], result["scope.left"][FRAMES - 1])
        self.assertIn("match.disparity", recording.keys())
        with self.assertRaises(KeyError):
            recording["scope.middle"]
        with self.assertRaises(IndexError):
            recording["scope.left"][FRAMES]
        self.assertIn('type = "stereo_bm"', recording.graph_text)
        again = ps.replay(file, watch=["match.disparity"])
        prints = [packet.fingerprint for packet in result["match.disparity"].packets()]
        self.assertEqual([packet.fingerprint for packet in again["match.disparity"].packets()], prints)
        other = ps.replay(file, watch=["match.disparity"], graph=graph, set={"match.search_px": 32}, frames=3)
        self.assertEqual(len(other["match.disparity"]), 3)
        self.assertNotEqual(other["match.disparity"].packet(0).fingerprint, prints[0])
        with self.assertRaises(ps.RecordingError):
            ps.replay(file, watch=["gone.image"])

    def test_isolated_nodes_and_nodes_in_python_run_in_processes_of_their_own(self):
        (self.folder / "mine.py").write_text(PYTHON_NODE)
        text = (
            'mode = "batch"\nplugin_paths = ["."]\nplugins = ["phantom", "flow", "mine"]\n'
            '[nodes.scope]\ntype = "phantom"\nisolate = "camera"\nparams = { width = 64, height = 48 }\n'
            '[nodes.inverse]\ntype = "invert"\ninputs = { image = "scope.left" }\n'
        )
        graph = self.graph(text)
        result = graph.run(frames=4, watch=["scope.left", "inverse.image"])
        self.assertEqual((len(result["inverse.image"]), result.faults), (4, []))
        self.assertEqual(set(result.report["groups"]), {"camera", "mine"})
        plain = self.graph(text.replace('isolate = "camera"\n', "")).run(frames=4, watch=["scope.left", "inverse.image"])
        np.testing.assert_array_equal(plain["inverse.image"].stack(), result["inverse.image"].stack())
        with self.assertRaisesRegex(ps.RunError, "never works") as raised:
            self.graph(text.replace('"invert"', '"fails"')).run(frames=4, watch=["inverse.image"])
        self.assertEqual(raised.exception.faults[0]["node"], "inverse")

    def test_a_slow_reader_loses_nothing_of_a_batch_and_old_frames_of_a_live_graph(self):
        text = 'mode = "batch"\nplugins = ["phantom"]\n[nodes.scope]\ntype = "phantom"\nparams = { width = 64, height = 48 }\n'
        with self.graph(text).start(watch=["scope.left", "scope.right"], frames=100) as running:
            count = settled(lambda: running.report["nodes"]["scope"]["count"])
            self.assertLess(count, 60, "the graph waits for its reader")
            # Whoever begins to iterate anew goes on where the last one stopped.
            first = next(packet for packet in running if packet.output == "scope.left")
            ticks = [first.tick, *(packet.tick for packet in running if packet.output == "scope.left")]
        self.assertEqual(ticks, list(range(100)))
        self.assertEqual(running.dropped, 0)
        with self.graph(text.replace("batch", "live")).start(watch=["scope.left"], frames=100, paced=False) as running:
            settled(lambda: running.report["nodes"]["scope"]["count"])
            ticks = [packet.tick for packet in running]
        self.assertEqual(ticks[-1], 99)
        self.assertEqual(running.dropped + len(ticks), 100)

    def test_many_runs_in_one_process_take_no_more_descriptors_and_memory(self):
        text = (
            'mode = "batch"\nplugins = ["phantom", "flow"]\n[nodes.scope]\ntype = "phantom"\nparams = { width = 64, height = 48 }\n'
            '[nodes.same]\ntype = "pass"\ninputs = { image = "scope.left" }\n'
        )
        isolated = text + '[isolate]\nflow = "group"\n'

        def once(number):
            graph = self.graph(isolated if number % 10 == 0 else text)
            graph.check()
            self.assertEqual(len(graph.run(frames=2, watch=["same.image"])["same.image"]), 2)
            gc.collect()
            page = os.sysconf("SC_PAGE_SIZE")
            memory_mb = int(Path("/proc/self/statm").read_text().split()[1]) * page / 1e6
            return len(os.listdir("/proc/self/fd")), memory_mb

        # Heaps and pools of threads reach their size in the first runs. The least of many: what a run has just left may still be going.
        runs = int(os.environ.get("PANOSCOPE_LEAK_RUNS", 12))
        levels = [once(number) for number in range(10 + runs)][10:]
        half = runs // 2
        first, last = (min(part) for part in zip(*levels[:half])), (min(part) for part in zip(*levels[half:]))
        (descriptors, memory_mb), (descriptors_end, memory_end_mb) = first, last
        print(f"{runs} runs: {descriptors} to {descriptors_end} descriptors, {memory_mb:.1f} to {memory_end_mb:.1f} MB", file=sys.stderr)
        self.assertLessEqual(descriptors_end, descriptors + 1)
        # A mapping of both plugins that stays would take 4 MB of each run, a scene of the phantom in each arena of the heap 36 MB.
        self.assertLess(memory_end_mb - memory_mb, 8 + 0.02 * runs)

    def test_other_threads_of_python_run_while_frames_do(self):
        counted, end = [0], threading.Event()

        def count():
            while not end.is_set():
                counted[0] += 1

        thread = threading.Thread(target=count)
        graph = self.graph()
        thread.start()
        before = counted[0]
        graph.run(frames=FRAMES, watch=["points.depth"])
        during = counted[0] - before
        end.set()
        thread.join()
        self.assertGreater(during, 1000)

    def test_a_graph_that_is_left_alone_ends_with_the_interpreter(self):
        script = (
            "import panoscope as ps, sys\n"
            "running = ps.Graph(sys.argv[1]).start(watch=['scope.left'])\n"
            "print(next(iter(running)).tick)\n"
        )
        file = self.graph().path
        done = subprocess.run([sys.executable, "-c", script, file], capture_output=True, text=True, timeout=300)
        self.assertEqual((done.returncode, done.stdout), (0, "0\n"), done.stderr)


class StudyTest(HostCase):
    """Sweeps, files and notebooks."""

    def test_a_sweep_is_that_of_the_command(self):
        rows = ps.sweep(self.graph(), "match.search_px", "match.p50_ms", start=32, stop=64, steps=2, frames=3)
        self.assertEqual([row["value"] for row in rows], ["32", "64"])
        self.assertTrue(all(row["failed"] is None and row["mean"] > 0 for row in rows), rows)
        with self.assertRaisesRegex(ps.GraphError, "no_such_param"):
            ps.sweep(self.graph(), "match.no_such_param", "match.p50_ms")

    def test_a_sweep_of_node_types_and_values_gives_a_row_per_combination(self):
        params = {"match.type": ["stereo_bm", "stereo_sgbm"], "match.search_px": (32, 64, 2)}
        out = self.folder / "study"
        rows = ps.sweep(self.graph(), params, ["match.p50_ms", "points.count"], frames=3, out=out)
        pairs = [(row["match.type"], row["match.search_px"]) for row in rows]
        self.assertEqual(pairs, [(name, px) for name in ("stereo_bm", "stereo_sgbm") for px in (32, 64)])
        self.assertTrue(all(row["match.p50_ms mean"] > 0 and row["points.count mean"] == 3 for row in rows), rows)
        self.assertTrue((out / "run_0004/results.json").is_file())
        drawn = ps.sweep(self.graph(), {"match.search_px": None}, "match.count", frames=2, random=3)
        self.assertEqual(len(drawn), 3)
        for wrong, words in (((1,), "a range is"), (3, "give a list")):
            with self.assertRaisesRegex(TypeError, words):
                ps.sweep(self.graph(), {"match.search_px": wrong}, "match.count")

    def test_a_recording_is_written_as_files(self):
        file = self.folder / "run.mcap"
        self.graph().record(file).run(frames=2, watch=["scope.left"])
        recording = ps.Recording(file)
        recording.to_folder(self.folder / "files", ["scope.left"])
        self.assertEqual(read_png(self.folder / "files/scope.left/000001.png"), (240, 320))
        with self.assertRaisesRegex(ps.RecordingError, "exists"):
            recording.to_folder(self.folder / "files")
        recording.to_foxglove(self.folder / "foxglove.mcap")
        self.assertGreater((self.folder / "foxglove.mcap").stat().st_size, 1000)

    def test_the_package_is_the_command(self):
        done = subprocess.run([sys.executable, "-m", "panoscope", "--version"], capture_output=True, text=True)
        self.assertEqual(done.stdout, subprocess.run([COMMAND, "--version"], capture_output=True, text=True).stdout)

    def test_notebooks_show_graphs_and_pictures(self):
        graph = self.graph()
        result = graph.run(frames=1, watch=["scope.left", "points.depth", "scope.calibration"])
        for output in ("scope.left", "points.depth"):
            packet = result[output].packet(0)
            file = self.folder / "picture.png"
            file.write_bytes(packet._repr_png_())
            self.assertEqual(read_png(file), packet.value.shape[:2])
        left = result["scope.left"][0]
        rows = zlib.decompress(chunk((self.folder / "picture.png").read_bytes(), b"IDAT"))
        self.assertEqual(len(rows), 240 * 321, "one byte a pixel, and one a row")
        result["scope.left"].packet(0).value[0, 0] = (1, 2, 3)
        rows = zlib.decompress(chunk(result["scope.left"].packet(0)._repr_png_(), b"IDAT"))
        self.assertEqual(tuple(rows[1:4]), (3, 2, 1), "red first")
        self.assertEqual(left.shape, (240, 320, 3))
        self.assertIsNone(result["scope.calibration"].packet(0)._repr_png_())
        self.assertIn("register", graph._repr_html_())


class PluginTest(HostCase):
    """Nodes in Python, and the examples of the documents."""

    def test_a_new_plugin_passes_its_test_and_runs(self):
        folder = self.folder / "made"
        command("new", "plugin", "fresh-node", "--python", "--dir", folder)
        # Of two versions of one second and one length, Python would run the first again.
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        # With a test that would fail, it fails.
        for text, passes in (("150", True), ("151", False)):
            test = folder / "test_fresh_node.py"
            test.write_text(test.read_text().replace("3), 150", f"3), {text}"))
            done = subprocess.run([sys.executable, "-m", "unittest"], cwd=folder, env=environment, capture_output=True, text=True)
            self.assertEqual(done.returncode == 0, passes, done.stderr)
        result = ps.Graph(folder / "fresh-node.toml").run(frames=2, watch=["scope.left", "filter.image"])
        brighter = np.clip(result["scope.left"].stack() * 1.5, 0, 255).astype(np.uint8)
        np.testing.assert_array_equal(result["filter.image"].stack(), brighter)

    def test_a_node_is_tested_without_a_host(self):
        @ps.node(name="of_test")
        class Sums:
            gain: float = ps.param(1.0, range=(0, 4))
            how: str = ps.param("whole", choices=("whole", "half"))

            def __init__(self):
                self.count = 0

            def process(self, images: list[ps.Gray8], mask: Optional[ps.Mask]) -> {"sum": ps.Gray8, "count": ps.Scalar, "same": ps.AnyImage}:
                self.count += 1
                ps.metric("images", len(images))
                total = sum(image.astype(np.float32) for image in images) * self.gain / (2 if self.how == "half" else 1)
                if mask is not None:
                    total[mask == 0] = 0
                return {"sum": total.astype(np.uint8), "count": self.count, "same": images[0]}

            def save_state(self):
                return bytes([self.count])

            def load_state(self, state):
                self.count = state[0]

        node = ps_testing.Node(Sums, gain=2.0)
        ones = np.ones((2, 3), np.uint8)
        outputs = node(images=[ones, ones])
        np.testing.assert_array_equal(outputs["sum"], 4 * ones)
        self.assertEqual((outputs["count"], node.metrics), (1.0, {"images": 2.0}))
        node.set(how="half")
        mask = np.array([[0, 255, 0], [255, 0, 255]], np.uint8)
        np.testing.assert_array_equal(node(images=[ones], mask=mask)["sum"], mask // 255)
        other = ps_testing.Node(Sums)
        other.load_state(node.save_state())
        self.assertEqual(other(images=[ones])["count"], 3.0)
        for mistake, words in (
            (lambda: node(images=[ones.astype(np.float32)]), "uint8"),
            (lambda: node(image=ones), "no input `image`; it has images, mask"),
            (lambda: node(), "`images` is missing"),
            (lambda: ps_testing.Node(Sums, gain=9.0), "`gain` is 0 to 4"),
            (lambda: ps_testing.Node(Sums, how="none"), "whole, half"),
            (lambda: ps_testing.Node(Sums, strength=1), "no parameter `strength`"),
            (lambda: ps_testing.Node(dict), "is no node"),
        ):
            with self.assertRaisesRegex((TypeError, ValueError, ps.NodeError), words):
                mistake()
        with self.assertRaisesRegex(ValueError, "read-only"):
            node(images=[ones])["same"][0, 0] = 1

    def test_tensors_of_other_libraries_are_read_without_a_copy(self):
        class Tensor:
            """As a library with DLPack has it, over an array."""

            def __init__(self, array):
                self.array = array

            def __dlpack__(self, **options):
                return self.array.__dlpack__(**options)

            def __dlpack_device__(self):
                return self.array.__dlpack_device__()

        class Far(Tensor):
            def __dlpack__(self, **options):
                raise BufferError("it is on a GPU")

        @ps.node(name="of_tensors")
        class Tensors:
            def process(self, image: ps.Gray8) -> ps.AnyImage:
                self.mine = ps.empty(image.shape)
                self.mine[...] = image + 1
                return {"made": Tensor(self.mine), "copied": Tensor(image + 2), "far": Far(image), "none": "text"}[self.how]

        node = ps_testing.Node(Tensors)
        ones = np.ones((3, 5), np.uint8)
        node.instance.how = "made"
        given = node(image=ones)
        self.assertTrue(np.shares_memory(given, node.instance.mine))
        np.testing.assert_array_equal(given, 2 * ones)
        node.instance.how = "copied"
        np.testing.assert_array_equal(node(image=ones), 3 * ones)
        for how, words in (("far", "Far: it is on a GPU"), ("none", "not str")):
            node.instance.how = how
            with self.assertRaisesRegex(TypeError, words):
                node(image=ones)

    def test_python_starts_for_a_description_only_when_something_changed(self):
        starts = self.folder / "starts"
        interpreter = self.folder / "python"
        interpreter.write_text(f'#!/bin/sh\necho >> "{starts}"\nexec "{sys.executable}" "$@"\n')
        interpreter.chmod(0o755)
        plugin = self.folder / "mine.py"
        plugin.write_text('# /// script\n# [tool.panoscope]\n# python = "python"\n# ///\n' + PYTHON_NODE)
        graph = self.folder / "graph.toml"
        graph.write_text(
            'mode = "batch"\nplugin_paths = ["."]\nplugins = ["phantom", "flow", "mine"]\n[nodes.scope]\ntype = "phantom"\n'
            '[nodes.inverse]\ntype = "invert"\ninputs = { image = "scope.left" }\n[nodes.end]\ntype = "drain"\ninputs = { image = "inverse.image" }\n'
        )
        environment = {**os.environ, "XDG_CACHE_HOME": str(self.folder / "cache")}

        def check():
            done = subprocess.run([COMMAND, "check", "--trust-plugins", graph], env=environment, capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            return len(starts.read_text().splitlines())

        self.assertEqual([check(), check()], [1, 1])
        (kept,) = (self.folder / "cache" / "panoscope" / "descriptions").iterdir()
        kept.write_bytes(b"damaged")
        self.assertEqual([check(), check()], [2, 2])
        plugin.write_text(plugin.read_text().replace("255 - image", "254 - image"))
        self.assertEqual([check(), check()], [3, 3])
        (self.folder / "helper.py").write_text("# The plugin could import it.")
        self.assertEqual([check(), check()], [4, 4])

    def test_the_examples_of_the_readme_run(self):
        text = (ROOT / "core" / "python" / "README.md").read_text()
        # One is about videos that are not there.
        blocks = [block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if ".mp4" not in block]
        self.assertEqual(len(blocks), 3)
        os.chdir(self.folder)
        names = {}
        for block in blocks:
            exec(block, names)
        self.assertEqual((len(names["result"]["wide.panorama"]), len(names["rows"])), (20, 2))
        written = sorted(file.name for file in self.folder.iterdir())
        self.assertEqual(len(names["found"][names["match"].disparity]), 3)
        self.assertEqual(written, ["a.mcap", "matched.toml", "out"], "what is watched writes nothing")
        self.assertEqual([file.name for file in (self.folder / "out").iterdir()], ["a"])


if __name__ == "__main__":
    unittest.main()
