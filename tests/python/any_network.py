"""A stereo network by the node `onnx` on real pairs: the values of ONNX Runtime in Python. Started by tests/tests/python_host.rs."""

import tempfile
import unittest
from pathlib import Path

import numpy as np
import onnxruntime

import panoscope as ps

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
MODEL = SHARED / "models/stereo_trial.onnx"
PAIRS = SHARED / "data/stereo/hamlyn_640x480"
FRAMES = 2
THREADS = 2
# Largest difference, px and ratio.
MOST = 1e-4

GRAPH = f"""
mode = "batch"
plugins = ["capture", "tools", "overlay", "flow"]
[nodes.scope]
type = "capture"
params = {{ left = '{PAIRS}/left/*.png', right = '{PAIRS}/right/*.png' }}
[nodes.network]
type = "onnx"
inputs = {{ left = "scope.left", right = "scope.right" }}
[nodes.network.params]
model = '{MODEL}'
threads = {THREADS}
table = '''
[inputs.left]
port = "left"
order = "rgb"
range = [0, 1]
[inputs.right]
port = "right"
order = "rgb"
range = [0, 1]
[outputs.disparity]
port = "disparity"
unit = "px"
[outputs.occlusion]
port = "mask"
[outputs.log_scale]
port = "confidence"
scale = -1
activation = "sigmoid"
'''
[nodes.colours]
type = "colorize"
inputs = {{ disparity = "network.disparity" }}
[nodes.ends]
type = "drain"
inputs = {{ image = "colours.image" }}
"""
WATCH = ["scope.left", "scope.right", "network.disparity", "network.mask", "network.confidence"]


class AnyNetwork(unittest.TestCase):
    def setUp(self):
        for path in (MODEL, PAIRS):
            if not path.exists():
                self.skipTest(f"{path} is not there")
        folder = tempfile.TemporaryDirectory(prefix="panoscope-network-")
        self.addCleanup(folder.cleanup)
        self.file = Path(folder.name) / "graph.toml"
        self.file.write_text(GRAPH)

    def test_the_values_are_those_of_onnx_runtime(self):
        result = ps.Graph(self.file).run(frames=FRAMES, watch=WATCH)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = THREADS
        session = onnxruntime.InferenceSession(MODEL, options, providers=["CPUExecutionProvider"])
        for tick in range(FRAMES):
            left, right, disparity, mask, confidence = (result[output][tick] for output in WATCH)
            self.assertEqual(left.shape, (480, 640, 3))
            planes = {
                name: (image[None, :, :, ::-1].astype(np.float32) / 255).transpose(0, 3, 1, 2)
                for name, image in (("left", left), ("right", right))
            }
            theirs, log_scale, occlusion = (
                out[0, 0] for out in session.run(["disparity", "log_scale", "occlusion"], planes)
            )
            known = np.isfinite(disparity)
            np.testing.assert_array_equal(known, theirs > 0)
            # Most of a real pair is matched: the comparison is about something.
            self.assertGreater(known.mean(), 0.9)
            self.assertGreater(np.ptp(theirs), 5)
            worst = {
                "disparity": np.abs(disparity - theirs)[known].max(),
                "confidence": np.abs(confidence - 1 / (1 + np.exp(log_scale.astype(np.float64)))).max(),
            }
            print({name: f"{value:.2g}" for name, value in worst.items()})
            self.assertLess(max(worst.values()), MOST, worst)
            np.testing.assert_array_equal(mask[np.abs(occlusion - 0.5) > MOST] > 0, (occlusion >= 0.5)[np.abs(occlusion - 0.5) > MOST])


if __name__ == "__main__":
    unittest.main()
