"""Topics of ROS 2 to and from Eclipse Cyclone DDS, which `rmw_cyclonedds` is made of, with the names and types that ROS gives them. Started by
tests/tests/live.rs; `PANOSCOPE_BIN` is the command. Everything stays on the loopback device."""

import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from dataclasses import dataclass, field
from pathlib import Path

# Before the import: the library reads it once. Domains up to 100 have ports that the system gives to nobody else.
DOMAIN = 20 + os.getpid() % 80
os.environ["CYCLONEDDS_URI"] = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<MaxAutoParticipantIndex>9</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
LIMIT = 40


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class DisparityImage(IdlStruct, typename="stereo_msgs::msg::dds_::DisparityImage_"):
    header: Header
    image: Image
    f: float32
    t: float32
    valid_window: RegionOfInterest
    min_disparity: float32
    max_disparity: float32
    delta_d: float32


@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64 = 0
    y: float64 = 0
    z: float64 = 0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64 = 0
    y: float64 = 0
    z: float64 = 0
    w: float64 = 1


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Point2D(IdlStruct, typename="vision_msgs::msg::dds_::Point2D_"):
    x: float64 = 0
    y: float64 = 0


@dataclass
class Pose2D(IdlStruct, typename="vision_msgs::msg::dds_::Pose2D_"):
    position: Point2D = field(default_factory=Point2D)
    theta: float64 = 0


@dataclass
class BoundingBox2D(IdlStruct, typename="vision_msgs::msg::dds_::BoundingBox2D_"):
    center: Pose2D
    size_x: float64
    size_y: float64


@dataclass
class ObjectHypothesis(IdlStruct, typename="vision_msgs::msg::dds_::ObjectHypothesis_"):
    class_id: str
    score: float64


@dataclass
class ObjectHypothesisWithPose(IdlStruct, typename="vision_msgs::msg::dds_::ObjectHypothesisWithPose_"):
    hypothesis: ObjectHypothesis
    pose: PoseWithCovariance


@dataclass
class Detection2D(IdlStruct, typename="vision_msgs::msg::dds_::Detection2D_"):
    header: Header
    results: sequence[ObjectHypothesisWithPose]
    bbox: BoundingBox2D
    id: str


@dataclass
class Detection2DArray(IdlStruct, typename="vision_msgs::msg::dds_::Detection2DArray_"):
    header: Header
    detections: sequence[Detection2D]


def quality(reliable=True):
    """As ROS has it: plain CDR, volatile."""
    reliability = Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort
    return Qos(reliability, Policy.Durability.Volatile, Policy.History.KeepLast(10), Policy.DataRepresentation(use_cdrv0_representation=True))


def stamp(ns):
    return Time(sec=ns // 10**9, nanosec=ns % 10**9)


PUBLISHES = """
mode = "live"
plugin_paths = ["."]
plugins = ["phantom", "stereo", "ros2", "plain"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2, rate_hz = 10 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.gives]
type = "gives"
inputs = { image = "scope.left" }
[nodes.ros]
type = "ros2_publish"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration", depth = "points.depth", disparity = "scope.disparity", cloud = "points.cloud", detections = "scope.detections", pose = "scope.pose", joints = "gives.joints" }
params = { namespace = "/scope", domain = DOMAIN, pictures = "both", stamps = "capture" }
"""
NODES = '''
import panoscope as ps
from panoscope.packets import record

@ps.node()
class Gives:
    def process(self, image: ps.Gray8) -> {"joints": ps.Joints}:
        _, tick, _ = ps.tick()
        return {"joints": record("joints", position_rad=(0.25, tick, 0, 0, 0, 0, 0, 0), velocity_rad_s=(1, 2, 0, 0, 0, 0, 0, 0), count=2)}
'''
SUBSCRIBES = """
mode = "live"
plugins = ["ros2", "flow"]
[nodes.ros]
type = "ros2_subscribe"
params = { domain = DOMAIN, left = "/cam/left/image_raw", right = "/cam/right/image_raw", disparity = "/cam/disparity", cloud = "/cam/points", detections = "/found", pose = "/tip/pose", joints = "/joint_states", reliable = true }
[nodes.end]
type = "drain"
inputs = { image = "ros.left" }
"""


class TopicTest(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory(prefix="panoscope-topics-")
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)
        (self.folder / "plain.py").write_text(NODES)
        self.member = DomainParticipant(DOMAIN)

    def start(self, graph):
        (self.folder / "graph.toml").write_text(graph.replace("DOMAIN", str(DOMAIN)))
        command = [COMMAND, "record", "graph.toml", "-o", "run.mcap", "--headless", "--all-ports"]
        environment = {**os.environ, "PANOSCOPE_PYTHON": sys.executable}
        self.process = subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
        self.addCleanup(self.kill)

    def kill(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        said, _ = self.process.communicate(timeout=60)
        self.assertEqual(self.process.returncode, 0, said)
        return ps.Recording(self.folder / "run.mcap"), said

    def wait_for(self, condition, step=lambda: None):
        end = time.monotonic() + LIMIT
        while not condition():
            self.assertLess(time.monotonic(), end, "nothing came")
            self.assertIsNone(self.process.poll(), "the run ended")
            step()
            time.sleep(0.02)

    def test_cyclone_receives_what_is_published(self):
        topics = {
            "rt/scope/left/image_raw": Image, "rt/scope/right/image_raw": Image, "rt/scope/left/image_raw/compressed": CompressedImage,
            "rt/scope/left/camera_info": CameraInfo, "rt/scope/right/camera_info": CameraInfo, "rt/scope/depth/image": Image,
            "rt/scope/disparity": DisparityImage, "rt/scope/points": PointCloud2, "rt/scope/detections": Detection2DArray,
            "rt/scope/pose": PoseStamped, "rt/scope/joint_states": JointState,
        }  # fmt: skip
        # Pictures also by best effort, as viewers ask for them.
        readers = {
            name: DataReader(self.member, Topic(self.member, name, kind, qos=quality()), qos=quality("image" not in name)) for name, kind in topics.items()
        }
        self.start(PUBLISHES)
        found = {name: [] for name in topics}

        def take():
            for name, reader in readers.items():
                found[name].extend(sample for sample in reader.take(N=10) if isinstance(sample, topics[name]))

        self.wait_for(lambda: all(len(samples) >= 2 for samples in found.values()), take)
        # Sockets of a domain on the loopback device receive nothing from elsewhere.
        recording, said = self.end()

        def recorded(port, message):
            at = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            series = recording[port]
            return series[list(series.capture_ns).index(at)]

        for side in ("left", "right"):
            for image in found[f"rt/scope/{side}/image_raw"]:
                self.assertEqual((image.encoding, image.header.frame_id), ("bgr8", f"{side}_optical_frame"))
                pixels = np.frombuffer(bytes(image.data), "u1").reshape(image.height, image.width, 3)
                np.testing.assert_array_equal(pixels, recorded(f"scope.{side}", image))
        self.assertEqual(bytes(found["rt/scope/left/image_raw/compressed"][0].data[:2]), b"\xff\xd8")
        for depth in found["rt/scope/depth/image"]:
            metres = np.frombuffer(bytes(depth.data), "<f4").reshape(120, 160)
            np.testing.assert_array_equal(metres, recorded("points.depth", depth) * np.float32(1e-3))
        baseline = recording["scope.calibration"][0].baseline_mm
        for disparity in found["rt/scope/disparity"]:
            px = np.frombuffer(bytes(disparity.image.data), "<f4").reshape(120, 160)
            np.testing.assert_array_equal(px, recorded("scope.disparity", disparity))
            self.assertAlmostEqual(disparity.t * 1000, baseline, places=4)
        right = found["rt/scope/right/camera_info"][0]
        self.assertAlmostEqual(-right.p[3] / right.p[0] * 1000, baseline, places=6)
        for cloud in found["rt/scope/points"]:
            points = np.frombuffer(bytes(cloud.data), [("xyz", "<f4", 3), ("rest", "u4")]).reshape(cloud.height, cloud.width)
            np.testing.assert_allclose(points["xyz"], recorded("points.cloud", cloud)["xyz_mm"] / 1000, rtol=1e-6)
        for boxes in found["rt/scope/detections"]:
            wanted = recorded("scope.detections", boxes).boxes
            self.assertEqual(len(boxes.detections), len(wanted))
            for box, own in zip(boxes.detections, wanted):
                self.assertAlmostEqual(box.bbox.center.position.x, float(own["x_px"] + own["width_px"] / 2), places=3)
        for pose in found["rt/scope/pose"]:
            wanted = recorded("scope.pose", pose)
            self.assertAlmostEqual(pose.pose.position.x * 1000, wanted["a_from_b_mm"][0], places=9)
        for joints in found["rt/scope/joint_states"]:
            self.assertEqual((joints.name, joints.position[0], joints.velocity), (["joint_0", "joint_1"], 0.25, [1, 2]))
            self.assertEqual(joints.position[1], recorded("gives.joints", joints)["position_rad"][1])

    def test_what_cyclone_publishes_is_received(self):
        kinds = {
            "rt/cam/left/image_raw": Image, "rt/cam/right/image_raw": Image, "rt/cam/left/camera_info": CameraInfo,
            "rt/cam/right/camera_info": CameraInfo, "rt/cam/disparity": DisparityImage, "rt/cam/points": PointCloud2,
            "rt/found": Detection2DArray, "rt/tip/pose": PoseStamped, "rt/joint_states": JointState,
        }  # fmt: skip
        writers = {name: DataWriter(self.member, Topic(self.member, name, kind, qos=quality()), qos=quality()) for name, kind in kinds.items()}
        self.start(SUBSCRIBES)
        self.wait_for(lambda: all(writer.get_matched_subscriptions() for writer in writers.values()))
        rng = np.random.default_rng(3)
        start, sent = 1_700_000_000 * 10**9, 12
        pictures = rng.integers(0, 256, (2, sent, 12, 16, 3), dtype=np.uint8)
        maps = rng.uniform(20, 60, (sent, 12, 16)).astype("<f4")
        maps[:, 0, 0] = np.nan
        points = rng.uniform(-0.05, 0.05, (sent, 192, 3)).astype("<f4")
        roi = RegionOfInterest()

        def image(header, encoding, pixels):
            return Image(header, 12, 16, encoding, 0, pixels[0].nbytes, list(pixels.tobytes()))

        for frame in range(sent):
            at = start + frame * 100_000_000
            header = Header(stamp(at), "cam")
            for side, name in enumerate(("left", "right")):
                p = [100.0, 0, 8, -1.5 * side, 0, 100, 6, 0, 0, 0, 1, 0]
                info = CameraInfo(header, 12, 16, "plumb_bob", [0.0] * 5, [100.0, 0, 8, 0, 100, 6, 0, 0, 1], [1.0, 0, 0, 0, 1, 0, 0, 0, 1], p, 0, 0, roi)
                writers[f"rt/cam/{name}/camera_info"].write(info)
                writers[f"rt/cam/{name}/image_raw"].write(image(header, "rgb8", pictures[side][frame]))
            writers["rt/cam/disparity"].write(DisparityImage(header, image(header, "32FC1", maps[frame]), 100, 0.015, roi, 0, 64, 0.1))
            fields = [PointField(name, offset, 7, 1) for name, offset in (("x", 0), ("y", 4), ("z", 8))]
            writers["rt/cam/points"].write(PointCloud2(header, 1, 192, fields, False, 12, 192 * 12, list(points[frame].tobytes()), True))
            hypothesis = ObjectHypothesisWithPose(ObjectHypothesis("hook", 0.5), PoseWithCovariance())
            box = Detection2D(header, [hypothesis], BoundingBox2D(Pose2D(Point2D(16 + frame, 22), 0), 30, 40), "7")
            writers["rt/found"].write(Detection2DArray(header, [box]))
            writers["rt/tip/pose"].write(PoseStamped(header, Pose(Point(0.01, 0.02, 0.03 + frame), Quaternion(0.5, -0.5, 0.5, 0.5))))
            writers["rt/joint_states"].write(JointState(header, ["a", "b"], [0.25, frame], [1.0, 2.0], []))
            time.sleep(0.1)
        time.sleep(0.5)
        recording, said = self.end()
        for side, name in enumerate(("left", "right")):
            series = recording[f"ros.{name}"]
            self.assertGreaterEqual(len(series), sent - 2, said)
            for tick, at in enumerate(series.capture_ns):
                # Times of a source grow: what came after another topic's message of the same stamp is a nanosecond later.
                frame = round((at - start) / 100_000_000)
                self.assertLess(abs(at - start - frame * 100_000_000), 100)
                np.testing.assert_array_equal(series[tick], pictures[side][frame][:, :, ::-1])
        frames = lambda port: [(round((at - start) / 100_000_000), recording[port][tick]) for tick, at in enumerate(recording[port].capture_ns)]
        for port in ("disparity", "cloud", "detections", "pose", "joints", "calibration"):
            self.assertGreaterEqual(len(recording[f"ros.{port}"]), sent - 2, port)
        for frame, disparity in frames("ros.disparity"):
            np.testing.assert_array_equal(disparity, maps[frame])
        for frame, cloud in frames("ros.cloud"):
            np.testing.assert_allclose(cloud["xyz_mm"][0], points[frame] * 1000, rtol=1e-5)
        for frame, detections in frames("ros.detections"):
            self.assertEqual((float(detections.boxes[0]["x_px"]), detections.labels, int(detections.boxes[0]["track_id"])), (1 + frame, ["hook"], 7))
        for frame, pose in frames("ros.pose"):
            np.testing.assert_allclose(pose["a_from_b_mm"], [10, 20, 30 + 1000 * frame], rtol=1e-9)
            np.testing.assert_array_equal(pose["a_from_b_wxyz"], [0.5, 0.5, -0.5, 0.5])
        for frame, joints in frames("ros.joints"):
            self.assertEqual((joints["position_rad"][0], joints["position_rad"][1], joints["count"]), (0.25, frame, 2))
        self.assertAlmostEqual(recording["ros.calibration"][0].baseline_mm, 15, places=6)

    def test_sockets_are_bound_to_the_loopback_device(self):
        self.start(PUBLISHES)
        ports = range(7400 + 250 * DOMAIN, 7650 + 250 * DOMAIN)
        bound = lambda: [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:] if int(line.split()[1].split(":")[1], 16) in ports]
        self.wait_for(lambda: len(bound()) > 1)
        # `ss` shows the device behind the address.
        try:
            sockets = subprocess.run(["ss", "-uanpH"], capture_output=True, text=True, check=True).stdout
        except (FileNotFoundError, subprocess.CalledProcessError):
            self.skipTest("no ss")

        def here():
            mine = [line.split()[3] for line in sockets.splitlines() if f"pid={self.process.pid}," in line]
            return [address for address in mine if int(address.rsplit(":", 1)[1]) in ports]

        def is_confined():
            return bool(here()) and all("%lo:" in address or address.startswith("127.0.0.1:") for address in here())

        # The sockets exist for a moment before the node binds them to the device.
        end = time.monotonic() + LIMIT
        while not is_confined() and time.monotonic() < end:
            time.sleep(0.1)
            sockets = subprocess.run(["ss", "-uanpH"], capture_output=True, text=True).stdout
        self.assertTrue(is_confined(), here())


if __name__ == "__main__":
    unittest.main()
