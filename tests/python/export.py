"""What `panoscope export` writes, read by the packages of others. Started by tests/tests/export.rs; `PANOSCOPE_BIN` is the command."""

import csv
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import foxglove.messages
import numpy as np
import PIL.Image
import pyarrow
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import RrdReader

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
FRAMES = 3

NODES = '''
import numpy as np
import panoscope as ps
from panoscope.packets import DETECTION, record

@ps.node()
class Gives:
    """One packet of each plain type."""

    def process(self, image: ps.Gray8) -> {
        "tip": ps.Tip, "pose": ps.Pose, "joints": ps.Joints, "number": ps.Scalar, "words": ps.Text, "rows": ps.Table,
        "boxes": ps.Detections, "area": ps.Roi, "map": ps.Homography, "deep": ps.Gray16,
    }:
        _, tick, _ = ps.tick()
        boxes = np.zeros(2, DETECTION)
        boxes[0] = (1, 2, 30, 40, 0.75, 1, 5)
        boxes[1] = (5.5, 6, 7, 8, 0.5, 0, -1)
        return {
            "tip": record("tip", u_px=3.5, v_px=4, xyz_mm=(1, -2, 50 + tick), score=0.5, xyz_valid=1, track_id=-1),
            "pose": record("pose", a_from_b_wxyz=(0.5, 0.5, -0.5, 0.5), a_from_b_mm=(10, 20, 30), a=b"base", b=b"camera"),
            "joints": record("joints", position_rad=(0.25, -0.5, 0, 0, 0, 0, 0, 0), velocity_rad_s=(1, 2, 0, 0, 0, 0, 0, 0), count=2),
            "number": 0.1 + tick,
            "words": 'one, "two"\\nthree',
            "rows": ps.Table(["x_mm", "y_mm"], np.array([[1.5, np.nan], [tick, 4.0]])),
            "boxes": ps.Detections(boxes, ["hook", "grasper"], (64, 48)),
            "area": record("roi", x=-1, y=2, width=30, height=40),
            "map": record("homography", left_from_right=np.arange(9.0).reshape(3, 3), rms_px=0.5, inliers=7, state=1),
            "deep": image.astype(np.uint16) * 257,
        }

@ps.node(family="sink")
class Takes:
    def process(self, tip: ps.Tip, deep: ps.Gray16, depth: ps.Depth, cloud: ps.Cloud) -> None:
        pass
'''
GRAPH = """
mode = "batch"
plugin_paths = ["."]
plugins = ["phantom", "stereo", "plain"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2 }
[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "rectify.left", right = "rectify.right" }
[nodes.points]
type = "reproject"
inputs = { image = "rectify.left", disparity = "match.disparity", calibration = "rectify.calibration" }
[nodes.gives]
type = "gives"
inputs = { image = "scope.left" }
[nodes.takes]
type = "takes"
inputs = { tip = "gives.tip", deep = "gives.deep", depth = "points.depth", cloud = "points.cloud" }
"""


def command(*words):
    """Runs the command; returns its exit code and what it printed."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, env={**os.environ, "PANOSCOPE_PYTHON": sys.executable})
    return done.returncode, done.stdout + done.stderr


class JsonDecoder:
    """Of the messages whose schema is Panoscope's."""

    def decoder_for(self, encoding, schema):
        return json.loads if encoding == "json" else None


class ExportTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory(prefix="panoscope-export-")
        cls.addClassCleanup(holder.cleanup)
        cls.folder = Path(holder.name)
        (cls.folder / "plain.py").write_text(NODES)
        (cls.folder / "graph.toml").write_text(GRAPH)
        cls.file = cls.folder / "run.mcap"
        code, words = command("record", cls.folder / "graph.toml", "-o", cls.file, "--frames", FRAMES, "--all-ports", "--headless")
        assert code == 0, words
        cls.recording = ps.Recording(cls.file)
        cls.out, cls.foxglove, cls.rerun = (cls.folder / name for name in ("out", "out.mcap", "out.rrd"))
        targets = ("--folder", cls.out, "--foxglove", cls.foxglove, "--rerun", cls.rerun)
        code, words = command("export", cls.file, "--trust-plugins", *targets)
        assert code == 0 and "left out" not in words, words

    def rows(self, name):
        with (self.out / name).open(newline="") as file:
            return list(csv.DictReader(file))

    def test_the_folder_has_every_port(self):
        index = {row["port"]: row for row in self.rows("index.csv")}
        self.assertEqual(set(index), set(self.recording))
        self.assertTrue(all(int(row["packets"]) == FRAMES and not row["left_out"] for row in index.values()), index)
        for port, form in (("scope.left", "PNG"), ("gives.deep", "PNG"), ("points.depth", "NPY"), ("points.cloud", "PLY"), ("gives.tip", "CSV")):
            self.assertEqual(index[port]["form"], form)

    def test_the_folder_has_the_pixels(self):
        for tick in range(FRAMES):
            left = np.asarray(PIL.Image.open(self.out / f"scope.left/{tick:06}.png"))
            np.testing.assert_array_equal(left[:, :, ::-1], self.recording["scope.left"][tick])
            deep = np.asarray(PIL.Image.open(self.out / f"gives.deep/{tick:06}.png"))
            np.testing.assert_array_equal(deep, self.recording["gives.deep"][tick])
            for port in ("match.disparity", "points.depth"):
                array = np.load(self.out / port / f"{tick:06}.npy")
                self.assertTrue(np.isnan(array).any() and np.isfinite(array).any(), port)
                np.testing.assert_array_equal(array, self.recording[port][tick])
            cloud = self.recording["points.cloud"][tick]
            known = cloud[np.isfinite(cloud["xyz_mm"]).all(axis=2)]
            head, body = (self.out / f"points.cloud/{tick:06}.ply").read_bytes().split(b"end_header\n", 1)
            self.assertIn(f"element vertex {len(known)}\n".encode(), head)
            points = np.frombuffer(body, [("xyz_mm", "<f4", 3), ("rgb", "u1", 3), ("filled", "u1")])
            np.testing.assert_array_equal(points["filled"], known["filled"])
            np.testing.assert_array_equal(points["xyz_mm"], known["xyz_mm"])
            np.testing.assert_array_equal(points["rgb"], known["bgr"][:, ::-1])

    def test_the_folder_has_the_numbers(self):
        tips = self.rows("gives.tip.csv")
        self.assertEqual([int(row["tick"]) for row in tips], list(range(FRAMES)))
        self.assertEqual([int(row["capture_ns"]) for row in tips], list(self.recording["gives.tip"].capture_ns))
        self.assertEqual([float(row["xyz_mm_2"]) for row in tips], [50, 51, 52])
        self.assertEqual([float(row["value"]) for row in self.rows("gives.number.csv")], [self.recording["gives.number"][i] for i in range(FRAMES)])
        self.assertEqual(self.rows("gives.words.csv")[1]["text"], 'one, "two"\nthree')
        table = [(int(row["tick"]), row["x_mm"], row["y_mm"]) for row in self.rows("gives.rows.csv")]
        self.assertEqual(table[2:4], [(1, "1.5", ""), (1, "1", "4")])
        boxes = self.rows("gives.boxes.csv")
        self.assertEqual([(row["label"], float(row["x_px"]), row["track_id"]) for row in boxes[:2]], [("grasper", 1.0, "5"), ("hook", 5.5, "-1")])
        self.assertEqual(self.rows("gives.map.csv")[0]["state"], "held")
        self.assertEqual(float(self.rows("gives.map.csv")[0]["left_from_right_5"]), 5.0)
        self.assertEqual(float(self.rows("gives.pose.csv")[0]["a_from_b_mm_2"]), 30.0)
        self.assertEqual(float(self.rows("gives.joints.csv")[0]["position_rad_1"]), -0.5)
        self.assertEqual(self.rows("gives.area.csv")[0]["x"], "-1")
        # One file for a calibration that stays; the graph reads it again.
        (calibration,) = (self.out / "scope.calibration").iterdir()
        self.assertIn("M1:", calibration.read_text())

    def masks(self, tick):
        """The number of the box in each pixel, by what the package reads."""
        masks = self.recording["scope.instances"][tick].masks
        self.assertGreater(len(masks), 0)
        numbers = np.zeros(masks.shape[1:], np.uint16)
        for number, mask in enumerate(masks, 1):
            self.assertTrue(mask.any())
            numbers[mask] = number
        return numbers

    def test_masks_are_pictures_with_numbers(self):
        rows = self.chunks()["/scope/instances/masks"]
        for tick, (_, _, image) in enumerate(self.messages("/scope/instances/masks")):
            numbers = self.masks(tick)
            np.testing.assert_array_equal(np.asarray(PIL.Image.open(self.out / f"scope.instances/{tick:06}.png")), numbers)
            np.testing.assert_array_equal(np.asarray(PIL.Image.open(io.BytesIO(image.data))), numbers)
            pixels = np.array(rows[tick]["SegmentationImage:buffer"][0], "u1").view("u2").reshape(numbers.shape)
            np.testing.assert_array_equal(pixels, numbers)
        self.assertEqual(len(self.rows("scope.instances.csv")), sum(len(packet.boxes) for packet in self.recording["scope.instances"]))

    def messages(self, topic):
        """Schema, message and decoded message of a topic."""
        with self.foxglove.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory(), JsonDecoder()])
            return [(found.schema, found.message, found.decoded_message) for found in reader.iter_decoded_messages(topics=[topic])]

    def test_foxglove_gets_its_own_schemas(self):
        with self.foxglove.open("rb") as file:
            summary = make_reader(file).get_summary()
        self.assertEqual({channel.topic.split("/")[1] for channel in summary.channels.values()}, {"scope", "rectify", "match", "points", "gives"})
        own = [schema for schema in summary.schemas.values() if schema.name.startswith("foxglove.")]
        self.assertEqual(
            {schema.name for schema in own},
            {
                f"foxglove.{name}"
                for name in (
                    "CompressedImage", "RawImage", "PointCloud", "CameraCalibration", "FrameTransforms", "FrameTransform", "ImageAnnotations",
                    "Point3InFrame", "PoseInFrame", "JointStates",
                )
            },
        )  # fmt: skip
        for schema in own:
            published = getattr(foxglove.messages, schema.name.removeprefix("foxglove.")).get_schema()
            self.assertEqual((schema.name, schema.encoding, schema.data), (published.name, published.encoding, published.data))
        with self.foxglove.open("rb") as file:
            times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
        self.assertEqual(times, sorted(times))

    def test_foxglove_gets_pixels_and_points(self):
        captured = list(self.recording["scope.left"].capture_ns)
        for tick, (schema, message, image) in enumerate(self.messages("/scope/left")):
            self.assertEqual((schema.name, message.log_time, image.frame_id), ("foxglove.CompressedImage", captured[tick], "left"))
            self.assertEqual(image.timestamp.ToNanoseconds(), captured[tick])
            np.testing.assert_array_equal(np.asarray(PIL.Image.open(io.BytesIO(image.data)))[:, :, ::-1], self.recording["scope.left"][tick])
        for port, scale, frame in (("match.disparity", 1, "left_rectified"), ("points.depth", np.float32(1e-3), "left_rectified"), ("gives.deep", 1, "left")):
            for tick, (schema, message, image) in enumerate(self.messages("/" + port.replace(".", "/"))):
                self.assertEqual((schema.name, image.frame_id), ("foxglove.RawImage", frame))
                dtype = {"32FC1": "<f4", "mono16": "<u2"}[image.encoding]
                pixels = np.frombuffer(image.data, dtype).reshape(image.height, image.step // np.dtype(dtype).itemsize)
                wanted = self.recording[port][tick]
                np.testing.assert_array_equal(pixels, wanted * scale if scale != 1 else wanted)
        for tick, (_, _, cloud) in enumerate(self.messages("/points/cloud")):
            points = np.frombuffer(cloud.data, [(field.name, "<f4" if field.type == 7 else "u1") for field in cloud.fields])
            self.assertEqual(points.dtype.itemsize, cloud.point_stride)
            wanted = self.recording["points.cloud"][tick]
            wanted = wanted[np.isfinite(wanted["xyz_mm"]).all(axis=2)]
            self.assertEqual(len(points), len(wanted))
            for at, name in enumerate("xyz"):
                np.testing.assert_allclose(points[name], wanted["xyz_mm"][:, at] / 1000, rtol=1e-6)
            np.testing.assert_array_equal(np.stack([points[name] for name in ("blue", "green", "red")], axis=1), wanted["bgr"])
            np.testing.assert_array_equal(points["filled"], wanted["filled"])

    def test_foxglove_gets_cameras_and_frames(self):
        calibration = self.recording["scope.calibration"][0]
        for name in ("left", "right"):
            _, _, camera = self.messages(f"/scope/calibration/{name}")[0]
            own = calibration[name]
            self.assertEqual((camera.width, camera.height, camera.frame_id), (160, 120, name))
            np.testing.assert_array_equal(np.reshape(camera.K, (3, 3)), [[own["fx"], 0, own["cx"]], [0, own["fy"], own["cy"]], [0, 0, 1]])
            np.testing.assert_array_equal(camera.D, own["distortion"][: len(camera.D)])
            self.assertFalse(own["distortion"][len(camera.D) :].any())
            self.assertEqual((len(camera.R), len(camera.P)), (9, 12))
        frames = {frame.child_frame_id: frame for frame in self.messages("/scope/calibration/frames")[0][2].transforms}
        at = frames["right"].translation
        wanted = -calibration.right_from_left_rotation.T @ calibration.right_from_left_mm / 1000
        np.testing.assert_allclose([at.x, at.y, at.z], wanted, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(wanted) * 1000, calibration.baseline_mm, rtol=1e-9)

    def test_foxglove_gets_the_numbers(self):
        _, _, boxes = self.messages("/gives/boxes")[0]
        self.assertEqual([text.text for text in boxes.texts], ["grasper 0.75 #5", "hook 0.50"])
        corners = [(point.x, point.y) for point in boxes.points[0].points]
        self.assertEqual((boxes.points[0].type, corners), (2, [(1, 2), (31, 2), (31, 42), (1, 42)]))
        _, _, point = self.messages("/gives/tip/position")[2]
        np.testing.assert_allclose([point.point.x, point.point.y, point.point.z], [0.001, -0.002, 0.052], rtol=1e-12)
        _, _, mark = self.messages("/gives/tip")[0]
        self.assertEqual((mark.circles[0].position.x, mark.circles[0].position.y), (3.5, 4))
        _, _, pose = self.messages("/gives/pose")[0]
        _, _, frame = self.messages("/gives/pose/frame")[0]
        self.assertEqual((pose.frame_id, frame.parent_frame_id, frame.child_frame_id), ("base", "base", "camera"))
        for place, turn in ((pose.pose.position, pose.pose.orientation), (frame.translation, frame.rotation)):
            np.testing.assert_allclose([place.x, place.y, place.z], [0.01, 0.02, 0.03], rtol=1e-12)
            self.assertEqual((turn.w, turn.x, turn.y, turn.z), (0.5, 0.5, -0.5, 0.5))
        _, _, joints = self.messages("/gives/joints")[0]
        self.assertEqual([(joint.name, joint.position, joint.velocity) for joint in joints.joints], [("joint_0", 0.25, 1), ("joint_1", -0.5, 2)])
        for port, wanted in (
            ("number", {"name": "number", "value": self.recording["gives.number"][1], "unit": ""}),
            ("words", {"text": 'one, "two"\nthree'}),
            ("rows", {"rows": [{"x_mm": 1.5, "y_mm": None}, {"x_mm": 1, "y_mm": 4}]}),
            ("map", {"left_from_right": list(range(9)), "rms_px": 0.5, "inliers": 7, "state": "held"}),
        ):
            schema, _, values = self.messages(f"/gives/{port}")[1]
            self.assertEqual((schema.encoding, values.pop("tick")), ("jsonschema", 1))
            self.assertEqual(values.pop("capture_ns"), self.recording[f"gives.{port}"].capture_ns[1])
            self.assertEqual(values, wanted)
            self.assertLessEqual(set(wanted), set(json.loads(schema.data)["properties"]))

    def chunks(self):
        """Rows by entity: tick, capture time in ns, and values by component."""
        rows = {}
        for chunk in RrdReader(self.rerun).stream():
            if "tick" not in chunk.timeline_names:
                continue
            batch = chunk.to_record_batch()
            columns = {name: batch[name] for name in batch.schema.names if ":" in name or "." not in name and name != "log_time"}
            columns["capture"] = columns["capture"].cast(pyarrow.int64())
            values = [column.to_pylist() for column in columns.values()]
            rows.setdefault(chunk.entity_path, []).extend(dict(zip(columns, row)) for row in zip(*values))
        return {entity: sorted(of, key=lambda row: row["tick"]) for entity, of in rows.items()}

    def test_rerun_gets_the_same(self):
        rows = self.chunks()
        shown = {"/" + port.replace(".", "/") for port in self.recording}
        self.assertTrue(all(any(entity == port or entity.startswith(port + "/") for entity in rows) for port in shown), rows.keys())
        for tick, row in enumerate(rows["/scope/left"]):
            self.assertEqual((row["tick"], row["capture"]), (tick, self.recording["scope.left"].capture_ns[tick]))
            pixels = np.array(row["Image:buffer"][0], "u1").reshape(self.recording["scope.left"][tick].shape)
            np.testing.assert_array_equal(pixels, self.recording["scope.left"][tick])
        for port, name in (("points.depth", "DepthImage"), ("match.disparity", "Image")):
            for tick, row in enumerate(rows["/" + port.replace(".", "/")]):
                wanted = self.recording[port][tick]
                pixels = np.array(row[f"{name}:buffer"][0], "u1").view("f4").reshape(wanted.shape)
                np.testing.assert_array_equal(pixels, wanted)
        self.assertEqual(rows["/points/depth"][0]["DepthImage:meter"], [1000.0])
        cloud = self.recording["points.cloud"][0]
        known = cloud[np.isfinite(cloud["xyz_mm"]).all(axis=2) & (cloud["filled"] == 0)]
        np.testing.assert_allclose(rows["/points/cloud"][0]["Points3D:positions"], known["xyz_mm"] / 1000, rtol=1e-6)
        self.assertEqual(rows["/gives/boxes"][0]["Boxes2D:labels"], ["grasper 0.75 #5", "hook 0.50"])
        self.assertEqual(rows["/gives/number"][2]["Scalars:scalars"], [self.recording["gives.number"][2]])
        self.assertEqual(rows["/gives/rows/x_mm"][2]["Scalars:scalars"], [1.5, 2.0])
        self.assertEqual(rows["/gives/words"][0]["TextLog:text"], ['one, "two"\nthree'])
        np.testing.assert_allclose(rows["/gives/pose"][0]["Transform3D:translation"], [[0.01, 0.02, 0.03]], rtol=1e-6)
        np.testing.assert_allclose(rows["/gives/tip/position"][1]["Points3D:positions"], [[0.001, -0.002, 0.051]], rtol=1e-6)
        self.assertEqual(rows["/gives/map"][0]["left_from_right"], list(map(float, range(9))))
        self.assertEqual(rows["/gives/joints/position_rad"][0]["Scalars:scalars"], [0.25, -0.5])

    def test_the_documented_layout_reads_a_recording(self):
        text = (Path(__file__).resolve().parents[2] / "core" / "runtime" / "record" / "README.md").read_text()
        (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        names = {}
        os.chdir(self.folder)
        exec(block, names)
        packet = self.recording["scope.left"].packet(FRAMES - 1)
        np.testing.assert_array_equal(names["left"], packet.value)
        self.assertEqual((names["tick"], names["capture_ns"], names["length"]), (packet.tick, packet.capture_ns, packet.value.size))

    def test_other_programs_seek_in_a_recording(self):
        graph, path = self.folder / "large.toml", self.folder / "large.mcap"
        graph.write_text(
            'mode = "batch"\nplugins = ["flow"]\n[nodes.a]\ntype = "frames"\nparams = { width_px = 640, height_px = 480, pattern = "noise", rate_hz = 200.0 }\n'
            '[nodes.end]\ntype = "drain"\ninputs = { image = "a.image" }\n'
        )
        code, words = command("record", graph, "-o", path, "--frames", 24, "--uncompressed", "--headless")
        self.assertEqual(code, 0, words)

        class Counting(io.BufferedReader):
            count = 0

            def read(self, size=-1):
                data = super().read(size)
                self.count += len(data)
                return data

        with Counting(io.FileIO(path)) as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            self.assertGreaterEqual(len(summary.chunk_indexes), 4)
            self.assertEqual(summary.statistics.chunk_count, len(summary.chunk_indexes))
            late = sorted(summary.chunk_indexes, key=lambda chunk: chunk.message_start_time)[-2].message_start_time
            file.count = 0
            found = [message.log_time for _, _, message in reader.iter_messages(topics=["a.image"], start_time=late)]
            # Two or three chunks of 4 MiB of 29 MB.
            self.assertLess(file.count, path.stat().st_size / 2)
            every = [message.log_time for _, _, message in reader.iter_messages(topics=["a.image"])]
        self.assertEqual(len(every), 24)
        self.assertEqual(found, [time for time in sorted(every) if time >= late])

    def test_ports_and_ticks_are_chosen_alike(self):
        targets = {name: self.folder / f"some.{name}" for name in ("folder", "foxglove", "rerun")}
        words = [word for name, path in targets.items() for word in (f"--{name}", path)]
        code, said = command("export", self.file, "--trust-plugins", "--ports", "scope.left,gives", "--from", 1, "--to", 1, *words)
        self.assertEqual(code, 0, said)
        with (targets["folder"] / "index.csv").open() as file:
            ports = {row["port"]: row["packets"] for row in csv.DictReader(file)}
        self.assertEqual(ports, {port: "1" for port in self.recording if port == "scope.left" or port.startswith("gives.")})
        with targets["foxglove"].open("rb") as file:
            summary = make_reader(file).get_summary()
            self.assertEqual(summary.statistics.message_start_time, self.recording["scope.left"].capture_ns[1])
            self.assertEqual(summary.statistics.message_end_time, summary.statistics.message_start_time)
        ticks = {tick for chunk in RrdReader(targets["rerun"]).stream() if "tick" in chunk.timeline_names for tick in chunk.to_record_batch()["tick"].to_pylist()}
        self.assertEqual(ticks, {1})
        self.assertIn("exists", command("export", self.file, "--rerun", targets["rerun"])[1])

    def test_what_cannot_be_shown_is_named(self):
        """Without trust the plugin of the recorded graph is not loaded, so the types of its plain data are not known."""
        targets = ("--folder", self.folder / "less", "--foxglove", self.folder / "less.mcap", "--rerun", self.folder / "less.rrd")
        code, words = command("export", self.file, "--ports", "gives", *targets)
        self.assertEqual(code, 0, words)
        self.assertEqual(words.count("`gives.tip` was left out"), 3, words)
        self.assertNotIn("`gives.deep` was left out", words)
        with (self.folder / "less" / "index.csv").open() as file:
            left_out = {row["port"] for row in csv.DictReader(file) if "plugin `plain`" in row["left_out"]}
        self.assertEqual(left_out, {port for port in self.recording if port.startswith("gives.") and port != "gives.deep"})

    def test_a_missing_package_is_named_with_its_remedy(self):
        (self.folder / "blocked").mkdir()
        (self.folder / "blocked" / "rerun.py").write_text("raise ImportError('blocked')")
        path = f"{self.folder / 'blocked'}:{os.environ['PYTHONPATH']}"
        code = "import sys, panoscope as ps; sys.path.insert(0, sys.argv[2]); ps.Recording(sys.argv[1]).to_rerun('none.rrd')"
        done = subprocess.run([sys.executable, "-c", code, self.file, self.folder / "blocked"], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path})
        self.assertIn("-m pip install rerun-sdk", done.stderr)
        done = subprocess.run(
            [COMMAND, "export", self.file, "--rerun", self.folder / "none.rrd"], capture_output=True, text=True, env={**os.environ, "PANOSCOPE_PYTHON": "/none/python"}
        )
        self.assertEqual(done.returncode, 1)
        self.assertIn("PANOSCOPE_PYTHON", done.stderr)
        self.assertIn("/none/python", done.stderr)


if __name__ == "__main__":
    unittest.main()
