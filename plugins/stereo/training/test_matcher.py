"""Tests of the training of `stereo_net`: exact pairs, a loop that learns and resumes, a network that uses its hints, an exported file that answers like PyTorch."""

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

from export_matcher import export, largest_difference
from fit_scale import fit
from matcher.network import CELLS, UNKNOWN, Exported, Matcher, correlation
from matcher.pairs import MATCHERS, PLANES, STEPS, filled_rows
from matcher.scenes import render

HERE = Path(__file__).parent


def fake_pairs(folder, pairs=60, size=(64, 96)):
    """Arrays as `make_pairs.py` writes them, with maps that are the truth with holes."""
    rng = np.random.default_rng(1)
    files = {name: (folder / f"{name}.{kind}").open("wb") for name, (kind, _) in PLANES.items()}
    maps = {name: (folder / f"{name}.i2").open("wb") for name in MATCHERS}
    for seed in range(pairs):
        pair = render(seed, *size)
        pair.disparity = np.rint(pair.disparity * STEPS)
        for name, (kind, _) in PLANES.items():
            files[name].write(getattr(pair, name).astype(kind).tobytes())
        for file in maps.values():
            file.write(np.where(rng.random(size) < 0.2, -32768, pair.disparity).astype("i2").tobytes())
    for file in (*files.values(), *maps.values()):
        file.close()
    (folder / "about.json").write_text(json.dumps({"pairs": pairs, "height": size[0], "width": size[1]}))


class MatcherTest(unittest.TestCase):
    def test_the_right_view_moved_by_the_truth_is_the_left_view(self):
        matches = []
        for seed in range(24):
            pair = render(seed, 160, 224)
            again = render(seed, 160, 224)
            self.assertTrue(np.array_equal(pair.left, again.left) and np.array_equal(pair.disparity, again.disparity))
            self.assertTrue(np.isfinite(pair.disparity).all() and (pair.disparity >= 1).all())
            x, y = np.meshgrid(np.arange(224, dtype=np.float32), np.arange(160, dtype=np.float32))
            moved = cv2.remap(pair.right, x - pair.disparity, y, cv2.INTER_LINEAR).mean(2, dtype=np.float64)
            seen = (pair.visible & pair.lit) > 0
            left = pair.left.mean(2, dtype=np.float64)
            if seen.sum() < 1000 or left[seen].std() < 20:
                continue  # Too faint to tell.
            there = np.corrcoef(left[seen], moved[seen])[0, 1]
            off = np.corrcoef(left[seen], np.roll(moved, 9, 1)[seen])[0, 1]
            self.assertGreater(there, off, seed)
            matches.append(there)
        # Smoke and light differ between the views of some.
        self.assertGreater(len(matches), 5)
        self.assertGreater(np.median(matches), 0.9)

    def test_training_learns_and_goes_on_where_it_ended(self):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "data").mkdir()
            fake_pairs(folder / "data")
            words = [sys.executable, "-B", HERE / "train_matcher.py", "--data", folder / "data", "--out", folder / "run", "--rows", "64"]
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
            self.assertEqual(set(scores), {*MATCHERS, "none"})
            self.assertTrue(all(np.isfinite(value) for one in scores.values() for value in one.values()))

    def test_the_comparison_finds_the_column_that_was_moved(self):
        random = torch.Generator().manual_seed(1)
        left = torch.nn.functional.normalize(torch.randn(1, 3, 60, 16, generator=random), dim=3)
        for cells in (0, 5, CELLS - 1):
            found = correlation(left, torch.roll(left, -cells, 2), CELLS)
            # The largest disparity comes first.
            best = CELLS - 1 - found[0, :, CELLS:].argmax(2)
            self.assertTrue(torch.equal(best, torch.full_like(best, cells)))

    def test_hidden_pixels_take_the_farther_neighbour_of_their_row(self):
        row = [UNKNOWN, 9, UNKNOWN, UNKNOWN, 4, UNKNOWN, 6, UNKNOWN]
        empty = [UNKNOWN] * 8
        filled = filled_rows(np.float32([row, empty, empty, [1] * 8]))
        expected = [9, 9, 4, 4, 4, 4, 6, 6]
        self.assertEqual(filled.tolist(), [expected, expected, [1] * 8, [1] * 8])
        self.assertEqual(filled_rows(np.float32([empty])).tolist(), [empty])

    def test_an_untrained_network_leans_on_its_hints_and_is_finite_without_them(self):
        torch.manual_seed(2)
        network = Matcher().eval()
        views = torch.rand(2, 1, 3, 64, 96)
        flat, known = torch.full((1, 1, 64, 96), 120.0), torch.ones(1, 1, 64, 96)
        known[:, :, 20:40, 30:60] = 0
        nothing = (torch.full_like(flat, UNKNOWN), torch.zeros_like(known))
        with torch.no_grad():
            kept = network(*views, flat, known)[0]
            alone = network(*views, *nothing)[0]
            empty = network(*torch.zeros_like(views), *nothing)
        self.assertLess(float((kept - 120.0).abs().mean()), 0.5 * float((alone - 120.0).abs().mean()))
        self.assertTrue(all(torch.isfinite(out).all() for out in empty))

    def test_a_scale_is_fitted_to_the_errors(self):
        random = np.random.default_rng(4)
        stated = np.exp(random.normal(0, 1, 20000))
        factor, power = fit(np.abs(random.laplace(0, 2.0 * stated**1.2)), stated)
        self.assertAlmostEqual(power, 1.2, delta=0.051)
        self.assertAlmostEqual(factor, 2.0, delta=0.15)

    def test_the_exported_file_answers_like_pytorch(self):
        torch.manual_seed(3)
        network = Exported(Matcher().eval(), 1.5, 0.9)
        with tempfile.TemporaryDirectory() as name:
            file = Path(name) / "matcher.onnx"
            export(network, file)
            self.assertLess(largest_difference(network, file), 1e-4)


if __name__ == "__main__":
    unittest.main()
