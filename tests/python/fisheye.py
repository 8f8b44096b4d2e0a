"""A pair of fisheyes beside a pair of pinholes of one focal length: both are calibrated on a rendered board, then lengths are measured whose true values
are known. Started by tests/tests/python_host.rs."""

import os
import subprocess
import tempfile
import unittest
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
KEPT = os.environ.get("PANOSCOPE_PICTURES")
"""Folder for the pictures, to look at them."""
ZOOM = 0.45
LENSES = {
    "pinhole": dict(lens="pinhole", distortion_k1=-0.05, distortion_k2=0.01),
    "equidistant": dict(lens="equidistant", distortion_k1=-0.05, distortion_k2=0.01),
}
MODELS = {"pinhole": "radial", "equidistant": "equidistant"}
FOCAL_PX, BASELINE_MM = 750 * ZOOM, 15.0
BOARD_MM, SCENE_MM = 26, 40


@dataclass
class Measured:
    """What a calibrated pair gives."""

    calibration: np.void
    lengths: np.ndarray
    """Rows of true, found and stated error, mm."""


class Fisheye(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory(prefix="panoscope-fisheye-")
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)

    def calibrated(self, lens):
        """Calibrates on the board, as a person with a printed one does."""
        board, out = self.folder / f"{lens}_board.toml", self.folder / f"{lens}.yml"
        graph = ps.Graph(mode="batch")
        graph.phantom(scene="board", distance_mm=BOARD_MM, zoom=ZOOM, **LENSES[lens], id="scope")
        graph.save(board)
        views = ["--graph", board, "--left", "scope.left", "--right", "scope.right", "--board", "chessboard:9x6:3mm", "--frames", "20"]
        pictures = ["--pictures", Path(KEPT) / lens] if KEPT else []
        done = subprocess.run([COMMAND, "calibrate", *views, "--model", MODELS[lens], "-o", out, *pictures], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return out

    def measured(self, lens, calibration):
        """Renders tissue, and measures it from the files."""
        scene = ps.Graph(mode="batch", name=f"{lens}_scene")
        scope = scene.phantom(scene="bowel", seed=7, distance_mm=SCENE_MM, zoom=ZOOM, speed_mm_s=0, breathing_mm=0, **LENSES[lens])
        scene.drain(scope.left)
        recording = self.folder / f"{lens}.mcap"
        scene.record(recording, all_ports=True).run(frames=1)
        truth = ps.Recording(recording)
        views = self.folder / f"{lens}_views"
        truth.to_folder(views, ["phantom.left", "phantom.right"], force=True)
        points = self.points(truth["phantom.depth"][0], truth["phantom.visible"][0])

        graph = ps.Graph(mode="batch", name=f"{lens}_lengths")
        source = graph.capture(left=views / "phantom.left/*.png", right=views / "phantom.right/*.png", calibration=calibration)
        stereo = graph.part("parts/stereo_depth.toml", left=source.left, right=source.right, calibration=source.calibration)
        rectified = graph.run(frames=1, watch=[stereo.calibration])[stereo.calibration][0]
        turn = np.reshape(rectified_from_left(calibration), (3, 3))
        camera = rectified.left
        seen = [turn @ point for point in points]
        px = [(camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]) for x, y, z in seen]
        pairs = [(a, b) for a in range(len(points)) for b in range(a + 1, len(points))]
        flat = [value for a, b in pairs for value in (*px[a], *px[b])]
        lengths = graph.measure(cloud=stereo.cloud, calibration=stereo.calibration, confidence=stereo.confidence, points=flat)
        result = graph.run(frames=1, watch=[stereo.left, stereo.depth, lengths.table])
        if KEPT:
            for output in (stereo.left, stereo.depth):
                (Path(KEPT) / f"{lens}_{output.port}.html").write_text(result[output].packet(0)._repr_html_())
        rows = result[lengths.table][0].rows
        true_mm = [np.linalg.norm(points[a] - points[b]) for a, b in pairs]
        found = np.array([(true, row[-2], row[-1]) for true, row in zip(true_mm, rows)])
        return Measured(rectified, found[np.isfinite(found).all(1)])

    def points(self, depth, visible):
        """True points of the tissue, in the frame of the left camera, mm, where both cameras see it."""
        height, width = depth.shape
        middle = ((width - 1) / 2, (height - 1) / 2)
        grid = [(u, v) for u in range(230, 600, 80) for v in range(60, 440, 100)]
        free = [(u, v) for u, v in grid if visible[v - 12 : v + 13, u - 12 : u + 13].all()]
        self.assertGreater(len(free), 12)
        return [np.array([(u - middle[0]) / FOCAL_PX, (v - middle[1]) / FOCAL_PX, 1.0]) * depth[v, u] for u, v in free]

    def test_lengths_of_a_fisheye_are_as_good_as_those_of_a_pinhole(self):
        files = {lens: self.calibrated(lens) for lens in LENSES}
        found = {lens: self.measured(lens, file) for lens, file in files.items()}
        errors = {}
        for lens, measured in found.items():
            true, mm, stated = measured.lengths.T
            self.assertAlmostEqual(float(measured.calibration["baseline_mm"]), BASELINE_MM, delta=0.15)
            self.assertGreater(len(true), 60)
            errors[lens] = 100 * np.abs(mm - true) / true
            within = 100 * (np.abs(mm - true) <= stated).mean()
            print(f"{lens}: {len(true)} lengths, error mean {errors[lens].mean():.2f} %, 95 % {np.percentile(errors[lens], 95):.2f} %, within stated {within:.0f} %, stated {np.median(stated):.2f} mm")
            self.assertGreaterEqual(within, 95)
            self.assertLess(errors[lens].mean(), 2.0)
        self.assertLess(errors["equidistant"].mean(), 1.5 * errors["pinhole"].mean() + 0.1)

        # The lens matters: with the same numbers, read as those of a pinhole, lengths are wrong.
        text = files["equidistant"].read_text()
        self.assertEqual(text.count("distortion_model: equidistant"), 1)
        files["equidistant"].write_text(text.replace("distortion_model: equidistant\n", ""))
        true, mm, _ = self.measured("equidistant", files["equidistant"]).lengths.T
        self.assertGreater((100 * np.abs(mm - true) / true).mean(), 2.0)


def rectified_from_left(file):
    """R1 of a calibration file."""
    text = Path(file).read_text()
    data = text[text.index("R1:") :]
    return [float(number) for number in data[data.index("[") + 1 : data.index("]")].replace("\n", " ").split(",")]


if __name__ == "__main__":
    unittest.main()
