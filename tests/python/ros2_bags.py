"""Bags of ROS 2: what `panoscope export --ros2` writes is read by rosbags, what rosbags writes is read by the node `ros2_bag`. Started by
tests/tests/live.rs; `PANOSCOPE_BIN` is the command."""

import io
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import PIL.Image
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

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

    def process(self, image: ps.Gray8) -> {"pose": ps.Pose, "joints": ps.Joints, "boxes": ps.Detections, "number": ps.Scalar, "deep": ps.Gray16}:
        _, tick, _ = ps.tick()
        boxes = np.zeros(2, DETECTION)
        boxes[0] = (1, 2, 30, 40, 0.75, 1, 5)
        boxes[1] = (5.5, 6, 7, 8, 0.5, 0, -1)
        return {
            "pose": record("pose", a_from_b_wxyz=(0.5, 0.5, -0.5, 0.5), a_from_b_mm=(10, 20, 30 + tick), a=b"base", b=b"camera"),
            "joints": record("joints", position_rad=(0.25, -0.5, 0, 0, 0, 0, 0, 0), velocity_rad_s=(1, 2, 0, 0, 0, 0, 0, 0), count=2),
            "boxes": ps.Detections(boxes, ["hook", "grasper"], (64, 48)),
            "number": 0.5,
            "deep": image.astype(np.uint16) * 257,
        }

@ps.node(family="sink")
class Takes:
    def process(self, pose: ps.Pose, deep: ps.Gray16, depth: ps.Depth, cloud: ps.Cloud) -> None:
        pass
'''
GRAPH = """
mode = "batch"
plugin_paths = ["."]
plugins = ["phantom", "stereo", "plain"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.gives]
type = "gives"
inputs = { image = "scope.left" }
[nodes.takes]
type = "takes"
inputs = { pose = "gives.pose", deep = "gives.deep", depth = "points.depth", cloud = "points.cloud" }
"""
PLAYS = """
mode = "batch"
plugins = ["ros2", "flow"]
[nodes.bag]
type = "ros2_bag"
params = { path = "BAG" }
[nodes.end]
type = "drain"
inputs = { image = "bag.left" }
"""

# What is computed from the views of a source named `scope`.
COMPUTES = """
[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "rectify.left", right = "rectify.right", calibration = "rectify.calibration" }
params = { search_px = 64, rectified_only = true }
[nodes.points]
type = "reproject"
inputs = { image = "rectify.left", disparity = "match.disparity", calibration = "rectify.calibration" }
[nodes.lengths]
type = "measure"
inputs = { cloud = "points.cloud", calibration = "rectify.calibration" }
params = { points = [90, 40, 130, 90] }
"""
# For views that are rectified: no node between the source and what needs them so.
COMPUTES_LEVEL = """
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { search_px = 64, rectified_only = true }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "match.disparity", calibration = "scope.calibration" }
[nodes.grid]
type = "register_grid"
inputs = { disparity = "match.disparity", calibration = "scope.calibration" }
[nodes.show]
type = "composite"
inputs = { left = "scope.left", right = "scope.right", homography = "grid.homography" }
[nodes.lengths]
type = "measure"
inputs = { cloud = "points.cloud", calibration = "scope.calibration" }
params = { points = [90, 40, 130, 90] }
[nodes.end]
type = "drain"
inputs = { image = "show.panorama" }
"""
PHANTOM = '[nodes.scope]\ntype = "phantom"\nparams = { width = 160, height = 120, LENS }\n'
FILES = '[nodes.scope]\ntype = "capture"\nparams = { left = "raw/phantom.left/*.png", right = "raw/phantom.right/*.png", calibration = "scope.yml" }\n'


def command(*words, cwd=None):
    """Runs the command; returns its exit code and what it printed."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, cwd=cwd, env={**os.environ, "PANOSCOPE_PYTHON": sys.executable})
    return done.returncode, done.stdout + done.stderr


class BagTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory(prefix="panoscope-bags-")
        cls.addClassCleanup(holder.cleanup)
        cls.folder = Path(holder.name)
        (cls.folder / "plain.py").write_text(NODES)
        (cls.folder / "graph.toml").write_text(GRAPH)
        cls.file, cls.bag = cls.folder / "run.mcap", cls.folder / "bag"
        code, words = command("record", cls.folder / "graph.toml", "-o", cls.file, "--frames", FRAMES, "--all-ports", "--headless")
        assert code == 0, words
        cls.recording = ps.Recording(cls.file)
        code, cls.said = command("export", cls.file, "--trust-plugins", "--ros2", cls.bag)
        assert code == 0, cls.said

    def play(self, bag, *words):
        """What `ros2_bag` gives of a bag, recorded; and what the command said."""
        graph, file = self.folder / f"play_{bag.name}.toml", self.folder / f"play_{bag.name}.mcap"
        graph.write_text(PLAYS.replace("BAG", str(bag)))
        code, said = command("record", graph, "-o", file, "--headless", "--all-ports", *words)
        return code, said, ps.Recording(file) if code == 0 else None

    def read(self):
        """Messages of our bag by topic: times and values."""
        found = {}
        with AnyReader([self.bag]) as reader:
            self.types = {connection.topic: connection.msgtype for connection in reader.connections}
            self.count = reader.message_count
            for connection, time, data in reader.messages():
                found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
        return found

    def test_rosbags_reads_what_is_exported(self):
        found = self.read()
        self.assertEqual(self.count, sum(map(len, found.values())))
        self.assertIn("`gives.number` was left out", self.said)
        for side in ("left", "right"):
            for tick, (time, image) in enumerate(found[f"/scope/{side}/image_raw"]):
                port = self.recording[f"scope.{side}"]
                self.assertEqual((time, image.header.frame_id, image.encoding), (port.capture_ns[tick], f"{side}_optical_frame", "bgr8"))
                self.assertEqual(image.header.stamp.sec * 10**9 + image.header.stamp.nanosec, time)
                np.testing.assert_array_equal(image.data.reshape(image.height, image.step // 3, 3), port[tick])
            info = found[f"/scope/{side}/camera_info"][0][1]
            own = self.recording["scope.calibration"][0][side]
            self.assertEqual((info.width, info.height, info.distortion_model), (160, 120, "plumb_bob"))
            np.testing.assert_array_equal(info.k.reshape(3, 3), [[own["fx"], 0, own["cx"]], [0, own["fy"], own["cy"]], [0, 0, 1]])
        baseline = self.recording["scope.calibration"][0].baseline_mm
        self.assertAlmostEqual(-info.p[3] / info.p[0] * 1000, baseline, places=9)
        deep = found["/gives/deep/image_raw"][1][1]
        np.testing.assert_array_equal(deep.data.view("<u2").reshape(120, 160), self.recording["gives.deep"][1])
        depth = found["/points/depth/image_raw"][2][1]
        self.assertEqual((depth.encoding, depth.header.frame_id), ("32FC1", "left_rectified_optical_frame"))
        np.testing.assert_array_equal(depth.data.view("<f4").reshape(120, 160), self.recording["points.depth"][2] * np.float32(1e-3))
        disparity = found["/scope/disparity"][0][1]
        np.testing.assert_array_equal(disparity.image.data.view("<f4").reshape(120, 160), self.recording["scope.disparity"][0])
        self.assertAlmostEqual(disparity.t * 1000, baseline, places=4)
        cloud, wanted = found["/points/cloud"][0][1], self.recording["points.cloud"][0]
        self.assertEqual([(field.name, field.offset, field.datatype) for field in cloud.fields], [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("rgb", 12, 7), ("filled", 15, 2)])
        points = cloud.data.view([("xyz", "<f4", 3), ("bgr", "u1", 3), ("filled", "u1")]).reshape(cloud.height, cloud.width)
        np.testing.assert_allclose(points["xyz"], wanted["xyz_mm"] / 1000, rtol=1e-6)
        np.testing.assert_array_equal(points["bgr"], wanted["bgr"])
        np.testing.assert_array_equal(points["filled"], wanted["filled"])
        boxes = found["/gives/boxes"][0][1].detections
        self.assertEqual([(box.results[0].hypothesis.class_id, box.results[0].hypothesis.score, box.id) for box in boxes], [("grasper", 0.75, "5"), ("hook", 0.5, "")])
        self.assertEqual((boxes[0].bbox.center.position.x, boxes[0].bbox.center.position.y, boxes[0].bbox.size_x), (16, 22, 30))
        pose = found["/gives/pose"][1][1]
        np.testing.assert_allclose([pose.pose.position.x, pose.pose.position.y, pose.pose.position.z], [0.01, 0.02, 0.031], rtol=1e-12)
        self.assertEqual((pose.header.frame_id, pose.pose.orientation.w, pose.pose.orientation.y), ("base", 0.5, -0.5))
        joints = found["/gives/joints"][0][1]
        self.assertEqual((list(joints.name), list(joints.position), list(joints.velocity)), (["joint_0", "joint_1"], [0.25, -0.5], [1, 2]))

    def test_definitions_are_those_of_ros(self):
        """Hashes of types are equal, field by field, to those of a distribution."""
        self.read()
        published = get_typestore(Stores.ROS2_JAZZY)
        own = get_typestore(Stores.EMPTY)
        with AnyReader([self.bag]) as reader:
            for connection in reader.connections:
                own.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        compared = [name for name in set(self.types.values()) if name in published.fielddefs]
        self.assertGreaterEqual(len(compared), 6, self.types)
        for name in compared:
            self.assertEqual(own.hash_rihs01(name), published.hash_rihs01(name), name)

    def test_our_own_bag_comes_back(self):
        code, said, played = self.play(self.bag)
        self.assertEqual(code, 0, said)

        def same(port, of, compare=np.testing.assert_array_equal):
            own, other = played[f"bag.{port}"], self.recording[of]
            self.assertEqual(len(own), FRAMES, port)
            for tick in range(FRAMES):
                compare(own[tick], other[tick])

        same("left", "scope.left")
        same("right", "scope.right")
        same("disparity", "scope.disparity")
        same("depth", "points.depth", lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6))
        same("cloud", "points.cloud", lambda a, b: np.testing.assert_allclose(a["xyz_mm"], b["xyz_mm"], rtol=1e-6))
        same("cloud", "points.cloud", lambda a, b: np.testing.assert_array_equal(a["filled"], b["filled"]))
        # Messages of one stamp are ticks of their own, a nanosecond apart.
        for own, other in zip(played["bag.left"].capture_ns, self.recording["scope.left"].capture_ns):
            self.assertLess(abs(own - other), 20)
        calibration, wanted = played["bag.calibration"][0], self.recording["scope.calibration"][0]
        self.assertAlmostEqual(calibration.baseline_mm, wanted.baseline_mm, places=6)
        self.assertEqual(calibration["left"]["fx"], wanted["left"]["fx"])
        np.testing.assert_allclose(calibration.right_from_left_mm, wanted.right_from_left_mm, atol=1e-6)

    def compare_with_played(self, name, source, computes, output):
        """The same graph on a source, and on the bag of its recording."""
        head = 'mode = "batch"\nplugins = ["phantom", "capture", "ros2", "stereo", "stitch", "flow"]\n'
        graph, bag = self.folder / f"{name}.toml", self.folder / f"{name}_bag"
        recordings = [self.folder / f"{name}_{which}.mcap" for which in ("source", "played")]
        graph.write_text(head + source + computes)
        code, said = command("record", graph, "-o", recordings[0], "--frames", FRAMES, "--all-ports", "--headless")
        self.assertEqual(code, 0, said)
        code, said = command("export", recordings[0], "--ros2", bag, "--ports", "scope.left,scope.right,scope.calibration")
        self.assertEqual(code, 0, said)
        graph.write_text(head + f'[nodes.scope]\ntype = "ros2_bag"\nparams = {{ path = "{bag}" }}\n' + computes)
        code, said = command("record", graph, "-o", recordings[1], "--all-ports", "--headless")
        self.assertEqual(code, 0, said)
        self.assertNotIn("calibration:", said)
        own, played = map(ps.Recording, recordings)
        self.assertEqual(own["scope.calibration"][0]["is_rectified"], played["scope.calibration"][0]["is_rectified"], name)
        self.assertEqual(len(played[output]), FRAMES, said)
        for one, other in zip(own[output], played[output]):
            self.assertGreater(np.isfinite(one).mean(), 0.2)
            # Metres and back: the last bits of a calibration differ, and so does a match here and there.
            is_same = np.isclose(one, other, rtol=1e-4) | (np.isnan(one) & np.isnan(other))
            self.assertGreater(is_same.mean(), 0.995)

    def test_a_recording_that_is_exported_and_played_runs_its_graph(self):
        for name, lens in (("pinhole", "seed = 3"), ("radial", "distortion_k1 = -0.1"), ("fisheye", 'lens = "equidistant", zoom = 0.6')):
            self.compare_with_played(name, PHANTOM.replace("LENS", lens), COMPUTES, "points.depth")
        self.compare_with_played("level", PHANTOM.replace("LENS", "seed = 3"), COMPUTES_LEVEL, "points.depth")

    def test_cameras_of_a_file_without_a_rectification_are_exported_as_a_pair(self):
        raw = ps.Graph(mode="batch")
        raw.drain(raw.phantom(width=160, height=120, distortion_k1=-0.1).left)
        raw.record(self.folder / "raw.mcap", all_ports=True).run(frames=FRAMES)
        recording = ps.Recording(self.folder / "raw.mcap")
        recording.to_folder(self.folder / "raw", ["phantom.left", "phantom.right", "phantom.calibration"])
        text = (self.folder / "raw/phantom.calibration/000000.yml").read_text()
        # The cameras and the pose between them alone, as OpenCV's calibration without its rectification.
        kept = text[: text.index("R1:")]
        self.assertIn("T:", kept)
        (self.folder / "scope.yml").write_text(kept)
        self.compare_with_played("bare", FILES, COMPUTES, "points.depth")

    def test_rectified_views_of_a_recording_are_played_as_rectified(self):
        graph = self.folder / "rectified.toml"
        lens = PHANTOM.replace("LENS", "distortion_k1 = -0.1")
        graph.write_text('mode = "batch"\nplugins = ["phantom", "stereo"]\n' + lens + COMPUTES)
        code, said = command("record", graph, "-o", self.folder / "rectified.mcap", "--frames", FRAMES, "--all-ports", "--headless")
        self.assertEqual(code, 0, said)
        bag = self.folder / "rectified_bag"
        code, said = command("export", self.folder / "rectified.mcap", "--ros2", bag, "--ports", "rectify")
        self.assertEqual(code, 0, said)
        text = f'mode = "batch"\nplugins = ["ros2", "stereo", "stitch", "flow"]\n[nodes.scope]\ntype = "ros2_bag"\nparams = {{ path = "{bag}" }}\n'
        (self.folder / "rectified_played.toml").write_text(text + COMPUTES_LEVEL)
        code, said = command("record", self.folder / "rectified_played.toml", "-o", self.folder / "played.mcap", "--all-ports", "--headless")
        self.assertEqual(code, 0, said)
        own, played = (ps.Recording(self.folder / f"{name}.mcap") for name in ("rectified", "played"))
        self.assertEqual((played["scope.calibration"][0]["is_rectified"], len(played["points.depth"])), (1, FRAMES))
        for one, other in zip(own["points.depth"], played["points.depth"]):
            self.assertGreater((np.isclose(one, other, rtol=1e-4) | (np.isnan(one) & np.isnan(other))).mean(), 0.995)

    def write(self, name, *, compression=CompressionMode.NONE, storage=StoragePlugin.MCAP, frames=4):
        """A bag by rosbags, with pictures in other forms than ours."""
        store = get_typestore(Stores.ROS2_JAZZY)
        types = store.types
        time_type, header_type, image_type = (types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/Image"))
        compressed_type, info_type = types["sensor_msgs/msg/CompressedImage"], types["sensor_msgs/msg/CameraInfo"]
        roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        rng = np.random.default_rng(5)
        pictures = {side: rng.integers(0, 256, (frames, 12, 16, 3), dtype=np.uint8) for side in ("left", "right")}
        writer = Writer(self.folder / name, version=9, storage_plugin=storage)
        if compression != CompressionMode.NONE:
            writer.set_compression(compression, CompressionFormat.ZSTD)
        start = 1_700_000_000 * 10**9
        with writer:
            left = writer.add_connection("/cam/left/image_raw", image_type.__msgtype__, typestore=store)
            right = writer.add_connection("/cam/right/image_raw/compressed", compressed_type.__msgtype__, typestore=store)
            infos = [writer.add_connection(f"/cam/{side}/camera_info", info_type.__msgtype__, typestore=store) for side in ("left", "right")]
            for frame in range(frames):
                # The right camera is 2 ms late, and its first picture is lost.
                stamps = [start + frame * 33_000_000 + late for late in (0, 2_000_000)]
                headers = [header_type(stamp=time_type(sec=at // 10**9, nanosec=at % 10**9), frame_id="cam") for at in stamps]
                for side, (connection, header) in enumerate(zip(infos, headers)):
                    p = np.array([100.0, 0, 8, -1.5 * side, 0, 100, 6, 0, 0, 0, 1, 0])
                    k, r = np.array([100.0, 0, 8, 0, 100, 6, 0, 0, 1]), np.eye(3).ravel()
                    info = info_type(header=header, height=12, width=16, distortion_model="plumb_bob", d=np.zeros(5), k=k, r=r, p=p, binning_x=0, binning_y=0, roi=roi)
                    writer.write(connection, stamps[side], store.serialize_cdr(info, info_type.__msgtype__))
                # rgb8 with padded rows.
                rows = np.zeros((12, 50), np.uint8)
                rows[:, :48] = pictures["left"][frame].reshape(12, 48)
                image = image_type(header=headers[0], height=12, width=16, encoding="rgb8", is_bigendian=0, step=50, data=rows.ravel())
                writer.write(left, stamps[0], store.serialize_cdr(image, image_type.__msgtype__))
                if frame > 0:
                    file = io.BytesIO()
                    PIL.Image.fromarray(pictures["right"][frame]).save(file, "png")
                    data = np.frombuffer(file.getvalue(), np.uint8)
                    packed = compressed_type(header=headers[1], format="rgb8; png compressed", data=data)
                    writer.write(right, stamps[1], store.serialize_cdr(packed, compressed_type.__msgtype__))
        return self.folder / name, pictures, start

    def test_a_bag_of_rosbags_is_played(self):
        bag, pictures, start = self.write("foreign")
        code, said, played = self.play(bag)
        self.assertEqual(code, 0, said)
        self.assertIn("/cam/right/image_raw/compressed", said)
        self.assertEqual(list(played["bag.left"].capture_ns), [start + frame * 33_000_000 for frame in (1, 2, 3)])
        for tick, frame in enumerate((1, 2, 3)):
            for side in ("left", "right"):
                np.testing.assert_array_equal(played[f"bag.{side}"][tick], pictures[side][frame][:, :, ::-1])
        calibration = played["bag.calibration"][0]
        self.assertAlmostEqual(calibration.baseline_mm, 15.0, places=9)
        np.testing.assert_allclose(calibration.right_from_left_mm, [-15, 0, 0], atol=1e-9)

    def test_compressed_chunks_are_read(self):
        bag, pictures, _ = self.write("chunks", compression=CompressionMode.STORAGE)
        code, said, played = self.play(bag)
        self.assertEqual(code, 0, said)
        np.testing.assert_array_equal(played["bag.left"][0], pictures["left"][1][:, :, ::-1])

    def test_what_cannot_be_played_is_named(self):
        for name, words, error in (
            ("sqlite", {"storage": StoragePlugin.SQLITE3}, "ros2 bag convert"),
            ("whole", {"compression": CompressionMode.FILE}, "zstd -d"),
            ("each", {"compression": CompressionMode.MESSAGE}, "compressed individually"),
        ):
            bag, _, _ = self.write(name, **words)
            code, said, _ = self.play(bag)
            self.assertNotEqual(code, 0)
            self.assertIn(error, said, name)

    def test_a_bag_that_is_cut_off_plays_to_there(self):
        bag, pictures, _ = self.write("cut", frames=40)
        (file,) = bag.glob("*.mcap")
        whole = file.read_bytes()
        file.write_bytes(whole[: len(whole) * 2 // 3])
        code, said, played = self.play(bag)
        self.assertIn("ends in the middle", said)
        self.assertEqual(code, 0, said)
        self.assertTrue(5 < len(played["bag.left"]) < 39, len(played["bag.left"]))
        damaged = bytearray(whole)
        damaged[len(whole) // 2 : len(whole) // 2 + 64] = bytes(range(64))
        file.write_bytes(damaged)
        code, said, _ = self.play(bag)
        self.assertNotEqual(code, 0)
        self.assertRegex(said, "is damaged|cannot be decoded|is not a ", said)


if __name__ == "__main__":
    unittest.main()
