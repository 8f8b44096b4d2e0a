"""OpenCV's block matching from Python in `graphs/depth.toml`: the same bytes as from the plugin `opencv`. Started by tests/tests/python_host.rs."""

import tempfile
import unittest
from pathlib import Path

import panoscope as ps
from panoscope import installation

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 3
# The phantom's disparities in depth.toml lie in this range.
SEARCH = "min_disparity_px = 160, search_px = 128, block_px = 15"
WATCH = ["stereo.disparity", "stereo.depth", "stereo.cloud", "lengths.table", "colours.image"]

NODE = '''
import cv2
import numpy as np
import panoscope as ps
from panoscope import installation

# With several threads, OpenCV's block matching gives other values from call to call in the first pixels of the rows where its stripes meet.
cv2.setNumThreads(1)


@ps.node(family="stereo")
class OpencvInPython:
    """OpenCV's block matching."""

    min_disparity_px: int = ps.param(0, range=(-1024, 1500), unit="px", doc="Smallest disparity that is searched")
    search_px: int = ps.param(64, range=(16, 512), unit="px", doc="Number of disparities that are searched")
    block_px: int = ps.param(15, range=(5, 31), unit="px", doc="Side of the window")

    def process(self, left: ps.Gray8, right: ps.Gray8) -> ps.Disparity:
        matcher = cv2.StereoBM_create(self.search_px, self.block_px)
        matcher.setMinDisparity(self.min_disparity_px)
        px = matcher.compute(left, right).astype(np.float32) / 16
        return np.where(px >= self.min_disparity_px, px, np.float32("nan"))
'''


class OpencvInDepth(unittest.TestCase):
    def setUp(self):
        scratch = tempfile.TemporaryDirectory(prefix="panoscope-opencv-")
        self.addCleanup(scratch.cleanup)
        self.folder = Path(scratch.name)
        (self.folder / "opencv_in_python.py").write_text(NODE)

    def depth(self, node_type, plugin, params):
        """Runs depth.toml with another matcher in its part."""
        folder = self.folder / node_type
        (folder / "parts").mkdir(parents=True)
        graph = (ROOT / "graphs/depth.toml").read_text().replace('mode = "live"', f'mode = "live"\nplugin_paths = ["{self.folder}"]')
        part = (ROOT / "graphs/parts/stereo_depth.toml").read_text()
        for old, new in (
            ('plugins = ["stereo"]', f'plugins = ["stereo", "{plugin}"]'),
            ('search_px = "match.search_px", ', ""),
            ('type = "stereo_sgbm"', f'type = "{node_type}"'),
            ("params = { speckle_area_px = 200 }", f"params = {{ {params} }}"),
            (', disparity_right = "match.disparity_right"', ""),
            (', drifted = "match.drifted"', ""),
        ):
            self.assertIn(old, part)
            part = part.replace(old, new)
        drifted = ', drifted = { from = "stereo.drifted", optional = true }'
        self.assertIn(drifted, graph)
        graph = graph.replace(drifted, "")
        (folder / "parts/stereo_depth.toml").write_text(part)
        (folder / "depth.toml").write_text(graph)
        return ps.Graph(folder / "depth.toml").run(frames=FRAMES, watch=WATCH)

    def test_the_same_bytes_as_the_plugin(self):
        if not any((Path(installation.use()).parent / "plugins").glob("*opencv*")):
            self.skipTest("this build has no plugin `opencv`")
        mine = self.depth("opencv_in_python", "opencv_in_python", SEARCH)
        theirs = self.depth("stereo_opencv", "opencv", f"auto_offset = false, {SEARCH}")
        for output in WATCH:
            with self.subTest(output):
                prints = [packet.fingerprint for packet in mine[output].packets()]
                self.assertEqual(len(prints), FRAMES)
                self.assertEqual(prints, [packet.fingerprint for packet in theirs[output].packets()])
        self.assertNotEqual(mine["stereo.depth"].packet(0).fingerprint, mine["stereo.depth"].packet(2).fingerprint)


if __name__ == "__main__":
    unittest.main()
