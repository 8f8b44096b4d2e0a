"""Odd files as people have them: each gives the right values, or is refused with the reason. Started by tests/tests/python_host.rs.

A case writes files into an empty folder and runs a graph there. `right` is the number of ticks that must come out, or None for a refusal, whose message
must match `words`. The pictures show red and green above blue and white."""

import io
import os
import pickle
import re
import struct
import subprocess
import tempfile
import unittest
import wave
import zipfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import cv2
import mcap.writer
import numpy as np
from PIL import Image
from rosbags.typesys import Stores, get_typestore

COMMAND = os.environ["PANOSCOPE_BIN"]
SIZE = (64, 48)
QUADRANTS = np.zeros((48, 64, 3), np.uint8)
QUADRANTS[:24, :32], QUADRANTS[:24, 32:] = (255, 0, 0), (0, 255, 0)
QUADRANTS[24:, :32], QUADRANTS[24:, 32:] = (0, 0, 255), (255, 255, 255)
PICTURE = Image.fromarray(QUADRANTS)
GRAY = np.asarray(PICTURE.convert("L"))
MAP = np.linspace(5, 20, 48 * 64, dtype=np.float32).reshape(48, 64)

HEAD = 'mode = "batch"\nplugins = ["capture", "sinks", "tools", "ros2", "stereo", "flow"]\n'
STILL = """
[nodes.cap]
type = "capture"
params = { left = 'FILE', frames = 8 }
[nodes.out]
type = "write_images"
inputs = { image = "cap.left" }
params = { path = "out/p_{seq}.png" }
"""
VIDEO = STILL.replace(", frames = 8", "")
CALIBRATED = """
[nodes.cap]
type = "capture"
params = { left = "l.png", right = "r.png", calibration = 'FILE', frames = 1 }
[nodes.rect]
type = "rectify"
inputs = { left = "cap.left", right = "cap.right", calibration = "cap.calibration" }
[nodes.map]
type = "read_maps"
inputs = { image = "rect.left" }
params = { path = 'm.npy' }
[nodes.points]
type = "reproject"
inputs = { image = "rect.left", disparity = "map.disparity", calibration = "rect.calibration" }
params = { far_mm = 1000.0 }
[nodes.out]
type = "write_raw"
inputs = { depth = "points.depth" }
params = { path = "out/d_{seq}.npy" }
"""
MAPS = """
[nodes.cap]
type = "capture"
params = { left = "l.png", frames = 1 }
[nodes.map]
type = "read_maps"
inputs = { image = "cap.left" }
params = { path = 'FILE' }
[nodes.out]
type = "write_raw"
inputs = { disparity = "map.disparity" }
params = { path = "out/m_{seq}.npy" }
"""
LABELS = """
[nodes.cap]
type = "capture"
params = { left = "l.png", frames = 1 }
[nodes.boxes]
type = "read_labels"
inputs = { image = "cap.left" }
params = { path = 'FILE' }
[nodes.out]
type = "write_table"
inputs = { detections = "boxes.detections" }
params = { path = "out/boxes.csv" }
"""
MODEL = """
[nodes.cap]
type = "capture"
params = { left = "l.png", frames = 1 }
[nodes.find]
type = "yolo"
inputs = { image = "cap.left" }
params = { model = 'FILE' }
[nodes.out]
type = "write_table"
inputs = { detections = "find.detections" }
params = { path = "out/boxes.csv" }
"""
BAG = """
[nodes.bag]
type = "ros2_bag"
params = { path = 'FILE' }
[nodes.out]
type = "write_images"
inputs = { image = "bag.left" }
params = { path = "out/p_{seq}.png" }
"""
CALIBRATION = """%YAML:1.0
---
image_width: 64
image_height: 48
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 70.5, 0., 31.5, 0., 70.5, 23.5, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 70.5, 0., 31.5, 0., 70.5, 23.5, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -15., 0., 0. ]
"""


@dataclass
class Case:
    name: str
    make: Callable[[Path], None]
    graph: str
    file: str
    right: int | None
    words: str = ""
    look: Callable[[Path], bool] | None = None
    """Whether the folder `out` has the right values."""
    command: tuple[str, ...] = ()
    """A command in place of the run of a graph."""


def saved(image: Image.Image, format: str, **options) -> bytes:
    file = io.BytesIO()
    image.save(file, format, **options)
    return file.getvalue()


def written(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(data) and None


def png(folder: Path, index: int = 0) -> np.ndarray:
    return np.asarray(Image.open(sorted(folder.glob("*.png"))[index]).convert("RGB")).astype(int)


def shows(tolerance: int = 3, picture: np.ndarray = QUADRANTS) -> Callable[[Path], bool]:
    """Whether the middle of each quadrant has its colour, in the first and last picture."""

    def look(out: Path) -> bool:
        for index in (0, -1):
            found = png(out, index)
            if found.shape != picture.shape:
                return False
            height, width = found.shape[:2]
            for y, x in ((height // 4, width // 4), (height // 4, 3 * width // 4), (3 * height // 4, width // 4), (3 * height // 4, 3 * width // 4)):
                if np.abs(found[y, x] - picture[y, x].astype(int)).max() > tolerance:
                    return False
        return True

    return look


def gray(value: np.ndarray) -> np.ndarray:
    return np.stack([value] * 3, 2)


def holds_map(out: Path) -> bool:
    return bool(np.allclose(np.load(next(out.glob("*.npy"))), MAP, atol=1 / 256))


def has_depths(out: Path) -> bool:
    """Depths by the focal length and the baseline of `CALIBRATION`."""
    return bool(np.allclose(np.load(next(out.glob("*.npy"))), 70.5 * 15 / MAP, rtol=1e-4))


def boxes(count: int) -> Callable[[Path], bool]:
    return lambda out: sum("hook" in line or ",0," in line for line in (out / "boxes.csv").read_text().splitlines()[1:]) == count


def pair(folder: Path) -> None:
    PICTURE.save(folder / "l.png")
    PICTURE.save(folder / "r.png")
    np.save(folder / "m.npy", MAP)


def with_pair(name: str, data: bytes) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        pair(folder)
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)

    return make


def folder_of(files: dict[str, bytes]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "views").mkdir()
        for name, data in files.items():
            (folder / "views" / name).write_bytes(data)

    return make


def movie(name: str, fourcc: str, size: tuple[int, int] = SIZE, frames: int = 6, keep: float = 1.0) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        file = folder / name
        writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*fourcc), 25, size)
        for _ in range(frames):
            writer.write(cv2.resize(QUADRANTS[:, :, ::-1], size, interpolation=cv2.INTER_NEAREST))
        writer.release()
        data = file.read_bytes()
        file.write_bytes(data[: int(len(data) * keep)])

    return make


def sound(folder: Path) -> None:
    with wave.open(str(folder / "only.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(b"\0\0" * 8000)


def pfm(big: bool, colour: bool = False) -> bytes:
    values = MAP[::-1].astype(">f4" if big else "<f4")
    head = b"%s\n64 48\n%s\n" % (b"PF" if colour else b"Pf", b"1.0" if big else b"-1.0")
    return head + (np.repeat(values[:, :, None], 3, 2) if colour else values).tobytes()


def npy(array: np.ndarray, **options) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


def zipped(name: str, data: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(name, data)
    return file.getvalue()


def bag(compression: mcap.writer.CompressionType, frames: int, encoding: str = "rgb8", chunked: bool = True) -> Callable[[Path], None]:
    """A bag as `ros2 bag` stores it, with a chunk for several messages."""

    def make(folder: Path) -> None:
        store = get_typestore(Stores.ROS2_JAZZY)
        image, header, time = (store.types[name] for name in ("sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
        with open(folder / "odd.mcap", "wb") as file:
            writer = mcap.writer.Writer(file, compression=compression, use_chunking=chunked)
            writer.start(profile="ros2")
            schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", store.generate_msgdef("sensor_msgs/msg/Image")[0].encode())
            channel = writer.register_channel("/camera/left/image_raw", "cdr", schema)
            for frame in range(frames):
                stamp = time(sec=1_700_000_000, nanosec=frame * 33_000_000)
                message = image(header(stamp, "cam"), 48, 64, encoding, 0, 192, QUADRANTS.reshape(-1))
                at = 1_700_000_000_000_000_000 + frame * 33_000_000
                writer.add_message(channel, at, bytes(store.serialize_cdr(message, "sensor_msgs/msg/Image")), at)
            writer.finish()

    return make


def voc(before: str = "", end: str = "\n") -> bytes:
    lines = ["<annotation>", "<size><width>64</width><height>48</height><depth>3</depth></size>", "<object><name>hook</name>",
             "<bndbox><xmin>5</xmin><ymin>6</ymin><xmax>30</xmax><ymax>40</ymax></bndbox></object>", "</annotation>"]  # fmt: skip
    return (before + end.join(lines)).encode()


PNG = saved(PICTURE, "png")
JPEG = saved(PICTURE, "jpeg", quality=95, subsampling=0)
PAGE = b"<!DOCTYPE html>\n<html><body><h1>404 Not Found</h1></body></html>\n"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"4d7a2146" * 8 + b"\nsize 12345\n"
HEADER = b"IHDR" + struct.pack(">II", 200_000, 200_000) + PNG[24:29]
BOMB = PNG[:12] + HEADER + struct.pack(">I", zlib.crc32(HEADER)) + PNG[33:]
YML = CALIBRATION.encode()
NONE = mcap.writer.CompressionType
WRAP = ("dicom", "wrap", "l.png", "--entry-file", "e.dcm", "-o", "out")
SKILL = ("eval", "skill", "t.csv", "--json", "skill.json")

CASES = [
    # Pictures.
    Case("palette with a transparent colour", written("a.png", saved(PICTURE.quantize(8), "png", transparency=0)), STILL, "a.png", 1, look=shows()),
    Case("gray of 16 bits", written("a.png", saved(Image.fromarray(GRAY.astype(np.uint16) * 257), "png")), STILL, "a.png", 1, look=shows(2, gray(GRAY))),
    Case("colours of 16 bits", written("a.png", cv2.imencode(".png", QUADRANTS[:, :, ::-1].astype(np.uint16) * 257)[1].tobytes()), STILL, "a.png", 1, look=shows()),
    Case("gray and alpha", written("a.png", saved(PICTURE.convert("LA"), "png")), STILL, "a.png", 1, look=shows(2, gray(GRAY))),
    Case("one bit", written("a.png", saved(PICTURE.convert("L").point(lambda v: 255 * (v > 100)).convert("1"), "png")), STILL, "a.png", 1, look=shows(2, gray(255 * (GRAY > 100)))),
    Case("JPEG for print (CMYK)", written("a.jpg", saved(PICTURE.convert("CMYK"), "jpeg", quality=95)), STILL, "a.jpg", 1, look=shows(40)),
    Case("progressive gray JPEG", written("a.jpg", saved(PICTURE.convert("L"), "jpeg", progressive=True, quality=95)), STILL, "a.jpg", 1, look=shows(4, gray(GRAY))),
    Case("JPEG named .png", written("a.png", JPEG), STILL, "a.png", 1, look=shows(6)),
    Case("PNG named .JPG", written("a.JPG", PNG), STILL, "a.JPG", 1, look=shows()),
    Case("JPEG with bytes behind its end", written("a.jpg", JPEG + b"\0" * 5000), STILL, "a.jpg", 1, look=shows(6)),
    Case("BMP of a palette", written("a.bmp", saved(PICTURE.quantize(8), "bmp")), STILL, "a.bmp", 1, look=shows()),
    Case("PPM in digits, with a comment", written("a.ppm", b"P3\n# by hand\n64 48\n255\n" + " ".join(map(str, QUADRANTS.ravel())).encode()), STILL, "a.ppm", None, "PNM P3\\) is not supported"),
    Case("TIFF of 16 bits, high byte first, LZW", written("a.tif", cv2.imencode(".tiff", GRAY.astype(np.uint16) * 257, [cv2.IMWRITE_TIFF_COMPRESSION, 5])[1].tobytes()), STILL, "a.tif", 1, look=shows(2, gray(GRAY))),
    Case("one pixel", written("a.png", saved(PICTURE.resize((1, 1)), "png")), STILL, "a.png", 1),
    Case("WebP", written("a.webp", saved(PICTURE, "webp", lossless=True)), STILL, "a.webp", 1, look=shows()),
    Case("moving GIF", written("a.gif", saved(PICTURE, "gif", save_all=True, append_images=[PICTURE.rotate(180)])), STILL, "a.gif", None, "gif|not supported|not an image"),
    Case("page of a server named .jpg", written("a.jpg", PAGE), STILL, "a.jpg", None, "a.jpg"),
    Case("empty picture", written("a.png", b""), STILL, "a.png", None, "a.png.*empty"),
    Case("half a PNG", written("a.png", PNG[: len(PNG) // 2]), STILL, "a.png", None, "a.png.*(damaged|cut off|ends)"),
    Case("PNG of 200000 x 200000 px", written("a.png", BOMB), STILL, "a.png", None, "200000|too large|limit"),
    Case("pointer of Git LFS named .png", written("a.png", POINTER), STILL, "a.png", None, "text file"),
    # Folders.
    Case("folder with a Mac's and a PC's own files", folder_of({"a1.png": PNG, "a2.png": PNG, "._a1.png": b"\0\5\x16\7junk", ".DS_Store": b"Bud1", "Thumbs.db": b"junk"}), VIDEO, "views", 2, look=shows()),
    Case("folder of two sizes", folder_of({"a1.png": PNG, "a2.png": saved(PICTURE.resize((32, 24)), "png")}), VIDEO, "views", 2, words="frame 2 is 32x24, those before it are 64x48"),
    Case("folder of PNG and JPEG together", folder_of({"a1.png": PNG, "a2.jpg": JPEG}), VIDEO, "views", 2, look=shows(6)),
    Case("name with blanks, quotes and an emoji", written("l'image \U0001f600 1.png", PNG), STILL.replace("'FILE'", '"FILE"'), "l'image \U0001f600 1.png", 1, look=shows()),
    Case("empty folder", lambda folder: (folder / "views").mkdir(), VIDEO, "views", None, "views"),
    # Videos.
    Case("AVI of MJPEG", movie("a.avi", "MJPG"), VIDEO, "a.avi", 6, look=shows(12)),
    Case("video of odd sides", movie("a.avi", "MJPG", size=(63, 47)), VIDEO, "a.avi", 6),
    Case("MP4 without its head at the end", movie("a.mp4", "mp4v", frames=40, keep=0.6), VIDEO, "a.mp4", None, "a.mp4"),
    Case("text named .mp4", written("a.mp4", b"to be uploaded\n"), VIDEO, "a.mp4", None, "a.mp4"),
    Case("empty video", written("a.mkv", b""), VIDEO, "a.mkv", None, "no data"),
    Case("sound without pictures", sound, VIDEO, "only.wav", None, "no video|not a video|sound"),
    # Calibrations.
    Case("calibration with a byte order mark and CR LF", with_pair("c.yml", b"\xef\xbb\xbf" + YML.replace(b"\n", b"\r\n")), CALIBRATED, "c.yml", 1, look=has_depths),
    Case("calibration in UTF-16", with_pair("c.yml", CALIBRATION.encode("utf-16")), CALIBRATED, "c.yml", None, "not text in UTF-8"),
    Case("calibration with decimal commas", with_pair("c.yml", YML.replace(b"70.5", b"70,5")), CALIBRATED, "c.yml", None, "M1"),
    Case("calibration of NumPy", with_pair("c.npz", zipped("M1.npy", npy(np.eye(3)))), CALIBRATED, "c.npz", None, "c.npz"),
    Case("calibration of OpenCV in XML", with_pair("c.xml", b'<?xml version="1.0"?>\n<opencv_storage>\n<image_width>64</image_width>\n</opencv_storage>\n'), CALIBRATED, "c.xml", None, "XML"),
    Case("calibration of another size", with_pair("c.yml", YML.replace(b"image_width: 64", b"image_width: 128")), CALIBRATED, "c.yml", None, "128x48"),
    # Maps.
    Case("map of float64 by columns", with_pair("m.npy", npy(np.asfortranarray(MAP.astype(np.float64)))), MAPS, "m.npy", 1, look=holds_map),
    Case("map with the high byte first", with_pair("m.npy", npy(MAP.astype(">f4"))), MAPS, "m.npy", 1, look=holds_map),
    Case("PFM with the high byte first", with_pair("m.pfm", pfm(True)), MAPS, "m.pfm", 1, look=holds_map),
    Case("PFM in colours", with_pair("m.pfm", pfm(False, True)), MAPS, "m.pfm", None, "m.pfm.*(PF|colour|channels|three)"),
    Case("disparity of KITTI", with_pair("m.png", cv2.imencode(".png", np.round(MAP * 256).astype(np.uint16))[1].tobytes()), MAPS, "m.png", 1, look=holds_map),
    Case("pickled objects named .npy", with_pair("m.npy", npy(np.array([{"a": 1}], object), allow_pickle=True)), MAPS, "m.npy", None, "m.npy"),
    Case("pickle named .npy", with_pair("m.npy", pickle.dumps(MAP)), MAPS, "m.npy", None, "m.npy"),
    Case("map of another size", with_pair("m.npy", npy(MAP[:24])), MAPS, "m.npy", None, "64x24"),
    # Boxes.
    Case("VOC with a byte order mark and CR LF", with_pair("labels/l.xml", voc("\ufeff", "\r\n")), LABELS, "labels", 1, look=boxes(1)),
    Case("YOLO without boxes", with_pair("labels/l.txt", b""), LABELS, "labels", 1, look=boxes(0)),
    Case("YOLO in px", with_pair("labels/l.txt", b"0 30 20 25 30\n"), LABELS, "labels", None, "line 1: 30 is not a share of the image"),
    Case("YOLO with names", with_pair("labels/l.txt", b"hook 0.5 0.5 0.2 0.2\n"), LABELS, "labels", None, "line 1: expected `class x y width height`"),
    # Models.
    Case("pointer of Git LFS named .onnx", with_pair("m.onnx", POINTER), MODEL, "m.onnx", None, "malformed or truncated"),
    Case("page of a server named .onnx", with_pair("m.onnx", PAGE), MODEL, "m.onnx", None, "malformed or truncated"),
    Case("PyTorch's file named .onnx", with_pair("m.onnx", zipped("archive/data.pkl", b"\x80\x02}q\0.")), MODEL, "m.onnx", None, "malformed or truncated"),
    Case("empty model", with_pair("m.onnx", b""), MODEL, "m.onnx", None, "has no graph"),
    # Bags.
    Case("bag with LZ4", bag(NONE.LZ4, 9), BAG, "odd.mcap", 9, look=shows()),
    Case("bag without chunks", bag(NONE.NONE, 4, chunked=False), BAG, "odd.mcap", 4, look=shows()),
    Case("bag without messages", bag(NONE.ZSTD, 0), BAG, "odd.mcap", None, "no topic|no messages|empty"),
    Case("bag of an unknown encoding", bag(NONE.ZSTD, 3, encoding="yuv444_x"), BAG, "odd.mcap", None, "yuv444_x"),
    Case("bag of ROS 1", written("odd.bag", b"#ROSBAG V2.0\n" + b"\0" * 200), BAG, "odd.bag", None, "ROS 1"),
    Case("text named .dcm", with_pair("e.dcm", b"not DICOM\n"), "", "e.dcm", None, "e.dcm", command=WRAP),
    Case("empty entry of DICOM", with_pair("e.dcm", b""), "", "e.dcm", None, "e.dcm", command=WRAP),
    # Tables.
    Case("table with semicolons", with_pair("t.csv", b"seq;capture_s;x_mm\n0;0,1;5,5\n"), "", "t.csv", None, "t.csv", command=SKILL),
    Case("table without rows", with_pair("t.csv", b"seq,capture_s,x_mm,y_mm,z_mm\n"), "", "t.csv", None, "t.csv", command=SKILL),
    Case("workbook named .csv", with_pair("t.csv", zipped("xl/workbook.xml", b"<workbook/>")), "", "t.csv", None, "t.csv", command=SKILL),
    Case("text named .mcap", written("odd.mcap", b"not a bag\n"), BAG, "odd.mcap", None, "odd.mcap"),
]


def run(case: Case) -> tuple[str, str]:
    """What is wrong with a case, empty if nothing, and the line that it printed about the file."""
    with tempfile.TemporaryDirectory(prefix="panoscope-odd-") as name:
        folder = Path(name)
        case.make(folder)
        (folder / "graph.toml").write_text(HEAD + case.graph.replace("FILE", case.file))
        words = case.command or ("run", "--headless", "graph.toml")
        done = subprocess.run([COMMAND, *words], cwd=folder, capture_output=True, text=True, timeout=120)
        said = done.stdout + done.stderr
        out = folder / "out"
        files = [file for file in out.glob("*") if not file.name.endswith((".log", ".partial"))] if out.is_dir() else []
        heads = [line for line in said.splitlines() if any(word in line.lower() for word in ("error", "warn", "done", case.file.lower()))]
        line = (heads or [said.strip()])[0][:200]
        if done.returncode < 0 or "panicked" in said:
            return f"it died: {done.returncode}\n{said}", line
        if case.right is None:
            if done.returncode == 0:
                return f"it is accepted: {[file.name for file in files]}\n{said}", line
            found = re.search(case.words, said, re.I)
            return ("" if found else f"{case.words!r} is not in\n{said}"), line
        if done.returncode != 0 or len(files) != case.right:
            return f"exit {done.returncode}, {len(files)} files\n{said}", line
        if case.look is not None and not case.look(out):
            return f"the values are wrong\n{said}", line
        if not re.search(case.words, said):
            return f"{case.words!r} is not in\n{said}", line
        return "", line


class OddFiles(unittest.TestCase):
    def test_each_is_right_or_refused_with_the_reason(self):
        self.assertGreaterEqual(len(CASES), 30)
        with ThreadPoolExecutor(2) as pool:
            results = list(pool.map(run, CASES))
        wrong = [f"== {case.name}: {mistake}" for case, (mistake, _) in zip(CASES, results) if mistake]
        for case, (mistake, line) in zip(CASES, results):
            print(f"{'WRONG ' if mistake else ''}{case.name}: {line}")
        self.assertFalse(wrong, "\n".join(wrong))


if __name__ == "__main__":
    unittest.main()
