"""Tests of the training of `stereo_net`: exact pairs, a loop that learns and resumes, an exported file that answers like PyTorch."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import cv2
import numpy as np
import torch

from export_refiner import export, largest_difference
from refiner.network import UNKNOWN, Refiner
from refiner.pairs import MATCHERS, STEPS
from refiner.scenes import render

HERE = Path(__file__).parent


def fake_pairs(folder, pairs=60, size=(64, 96)):
    """Arrays as `make_pairs.py` writes them, with maps that are the truth with holes."""
    rng = np.random.default_rng(1)
    planes = {name: [] for name in ("left", "right", "disparity", "visible", "lit")}
    maps = {name + side: [] for name in MATCHERS for side in ("", "_right")}
    for seed in range(pairs):
        pair = render(seed, *size)
        for name, all_planes in planes.items():
            all_planes.append(getattr(pair, name))
        holed = np.where(rng.random(size) < 0.2, -32768, np.rint(pair.disparity * STEPS))
        for name, all_maps in maps.items():
            all_maps.append(holed if not name.endswith("_right") else np.full(size, -32768))
    for name, all_planes in planes.items():
        kind, factor = ("i2", STEPS) if name == "disparity" else ("u1", 1)
        np.rint(np.stack(all_planes) * factor).astype(kind).tofile(folder / f"{name}.{kind}")
    for name, all_maps in maps.items():
        np.stack(all_maps).astype("i2").tofile(folder / f"{name}.i2")
    (folder / "about.json").write_text(json.dumps({"pairs": pairs, "height": size[0], "width": size[1]}))


class RefinerTest(unittest.TestCase):
    def test_the_right_view_moved_by_the_truth_is_the_left_view(self):
        matches = []
        for seed in range(12):
            pair = render(seed, 160, 224)
            again = render(seed, 160, 224)
            self.assertTrue(np.array_equal(pair.left, again.left) and np.array_equal(pair.disparity, again.disparity))
            self.assertTrue(np.isfinite(pair.disparity).all() and (pair.disparity >= 1).all())
            x, y = np.meshgrid(np.arange(224, dtype=np.float32), np.arange(160, dtype=np.float32))
            moved = cv2.remap(pair.right, x - pair.disparity, y, cv2.INTER_LINEAR).astype(np.float64)
            seen = (pair.visible & pair.lit) > 0
            left = pair.left.astype(np.float64)
            if left[seen].std() < 20:
                continue  # Too faint to tell.
            there = np.corrcoef(left[seen], moved[seen])[0, 1]
            off = np.corrcoef(left[seen], np.roll(moved, 9, 1)[seen])[0, 1]
            self.assertGreater(there, off, seed)
            matches.append(there)
        # Smoke and light differ between the views of some.
        self.assertGreater(len(matches), 3)
        self.assertGreater(np.median(matches), 0.9)

    def test_training_learns_and_goes_on_where_it_ended(self):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "data").mkdir()
            fake_pairs(folder / "data")
            words = [sys.executable, "-B", HERE / "train_refiner.py", "--data", folder / "data", "--out", folder / "run", "--rows", "64"]
            words += ["--batch", "2", "--threads", "1", "--minutes", "30", "--max-steps"]
            run = lambda steps: subprocess.run([*map(str, words), str(steps)], check=True, capture_output=True, text=True, env=dict(os.environ), cwd=HERE).stdout
            run(2)
            first = torch.load(folder / "run/state.pt", weights_only=True)
            self.assertEqual(first["step"], 2)
            self.assertIn("step 2,", run(4))
            second = torch.load(folder / "run/state.pt", weights_only=True)
            self.assertEqual(second["step"], 4)
            self.assertFalse(all(torch.equal(first["network"][key], second["network"][key]) for key in first["network"]))
            scores = json.loads((folder / "run/scores.json").read_text())["scores"]
            self.assertEqual(set(scores), set(MATCHERS))
            self.assertTrue(all(np.isfinite(value) for one in scores.values() for value in one.values()))

    def test_an_untrained_network_keeps_what_is_known_and_is_finite_where_nothing_is(self):
        network = Refiner().eval()
        flat = torch.full((1, 1, 64, 96), 20.0)
        with torch.no_grad():
            kept = network(torch.rand(1, 1, 64, 96), torch.rand(1, 1, 64, 96), flat, flat)[0]
            empty = network(*(torch.zeros(1, 1, 64, 96) for _ in range(2)), *(torch.full((1, 1, 64, 96), UNKNOWN) for _ in range(2)))
        self.assertLess(float((kept - flat).abs().max()), 1.0)
        self.assertTrue(all(torch.isfinite(out).all() for out in empty))

    def test_the_exported_file_answers_like_pytorch(self):
        torch.manual_seed(3)
        network = Refiner().eval()
        with tempfile.TemporaryDirectory() as name:
            file = Path(name) / "refiner.onnx"
            export(network, file)
            self.assertLess(largest_difference(network, file), 1e-4)


if __name__ == "__main__":
    unittest.main()
