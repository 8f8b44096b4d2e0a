"""Networks, augmentation and the training loop; needs PyTorch, NumPy, OpenCV and onnx: python3 -m unittest test_training"""

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import cv2
import numpy as np
import torch

from instruments import augment, lite, networks
from instruments.assign import loss
from instruments.data import Frame
from instruments.training import Checkpoint, Pause, Schedule

HERE = Path(__file__).parent


FOLDS = 'data = "d"\nsplits = ["train"]\nframe_rate_hz = 25.0\nblock_s = 10.0\n[folds]\n1 = ["b"]\n2 = ["a"]\n'


def tiny_data(folder):
    """Eight frames of operation a and three of b with a box each, in YOLO's layout, and folds of them."""
    rng = np.random.default_rng(2)
    (folder / "images" / "train").mkdir(parents=True)
    (folder / "labels" / "train").mkdir(parents=True)
    for name in [f"a_{i}" for i in range(8)] + [f"b_{i}" for i in range(3)]:
        picture = rng.integers(0, 120, (54, 96, 3)).astype(np.uint8)
        cv2.rectangle(picture, (30, 20), (60, 40), (200, 200, 200), -1)
        cv2.imwrite(str(folder / "images" / "train" / f"{name}.jpg"), picture)
        (folder / "labels" / "train" / f"{name}.txt").write_text("2 0.47 0.55 0.31 0.37\n")
    (folder / "folds.toml").write_text(FOLDS)


def train(folder, out, *more):
    """Runs the script for two epochs of four batches on fold 1 of the tiny data."""
    command = [sys.executable, "-B", HERE / "train_detector.py", "--data", folder / "data", "--folds", folder / "data" / "folds.toml"]
    command += ["--fold", "1", "--out", out, "--start", "none", "--epochs", "2", "--batch", "2", "--width", "96", "--height", "64"]
    command += ["--threads", "1", "--plain-share", "0.5", "--augment", "all", *more]
    return subprocess.run(command, capture_output=True, text=True)


def randomised(model):
    """Statistics of the normalisations away from 0 and 1, so that folding has something to fold."""
    torch.manual_seed(3)
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.2)
            module.running_var.uniform_(0.5, 1.5)
            module.weight.data.uniform_(0.5, 1.5)
            module.bias.data.normal_(0, 0.2)
    return model.eval()


class Networks(unittest.TestCase):
    def test_the_exported_network_answers_as_the_trained_one(self):
        x = torch.from_numpy(np.random.default_rng(1).integers(0, 256, (1, 3, 64, 96))).float()
        for kind in ("yolox-nano", "lite0"):
            model = randomised(networks.build(kind, 7))
            with torch.no_grad():
                levels = [torch.cat((v[:, :4], v[:, 4:].sigmoid()), 1).flatten(2) for v in model(x)]
                want, got = torch.cat(levels, 2).permute(0, 2, 1), networks.Exported(model)(x)
            self.assertEqual(got.shape, (1, 8 * 12 + 4 * 6 + 2 * 3, 12), kind)
            self.assertGreater(float(want.std()), 1e-3, kind)
            self.assertLess(float((got - want).abs().max()), 1e-3 * float(want.abs().max()), kind)

    def test_frozen_stages_stay_and_the_rest_learns(self):
        model = networks.build("lite0", 7).train()
        model.freeze(2)
        before = {k: v.clone() for k, v in model.state_dict().items()}
        optimiser = torch.optim.SGD(model.parameters(), lr=0.1)
        x = torch.rand(2, 3, 64, 64) * 255
        loss(model(x), [torch.tensor([[1.0, 30, 30, 20, 20]])] * 2).backward()
        optimiser.step()
        changed = {k for k, v in model.state_dict().items() if not torch.equal(v, before[k])}
        fixed = ("backbone.stem", "backbone.stages.0.", "backbone.stages.1.")
        self.assertFalse([k for k in changed if k.startswith(fixed)])
        self.assertTrue([k for k in changed if k.startswith("backbone.stages.2.")])
        self.assertTrue([k for k in changed if k.startswith("class_heads")])

    def test_weights_of_another_backbone_are_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "weights.pth"
            torch.save({"_conv_stem.weight": torch.zeros(32, 3, 5, 5)}, path)
            with self.assertRaisesRegex(ValueError, "weights.pth.*_conv_stem.weight"):
                lite.load_imagenet(lite.Backbone("lite0"), path)

    def test_same_padding_is_that_of_tensorflow(self):
        self.assertEqual([lite.same_padding(k, s) for k, s in ((3, 1), (3, 2), (5, 2), (1, 1))], [(1, 1, 1, 1), (0, 1, 0, 1), (1, 2, 1, 2), (0, 0, 0, 0)])


class Augmentation(unittest.TestCase):
    def test_changes_are_chosen_by_name(self):
        self.assertEqual(augment.chosen_changes("usual"), augment.USUAL)
        self.assertEqual(augment.chosen_changes("none"), frozenset())
        self.assertEqual(augment.chosen_changes("usual, blood,-smoke"), augment.USUAL - {"smoke"} | {"blood"})
        self.assertEqual(augment.chosen_changes("all,-usual"), {"white_balance", "blood", "highlight"})
        with self.assertRaisesRegex(ValueError, "no change `fog`; there are .*smoke"):
            augment.chosen_changes("fog")

    def test_each_change_changes_the_picture_and_keeps_its_form(self):
        picture = np.random.default_rng(1).integers(60, 200, (90, 160, 3)).astype(np.uint8)
        for name, (change, _) in augment.CHANGES.items():
            changed = change(picture.copy(), np.random.default_rng(4))
            self.assertEqual((changed.shape, changed.dtype), (picture.shape, picture.dtype), name)
            self.assertGreater(float(np.abs(changed.astype(int) - picture).mean()), 0.05, name)

    def test_blood_and_highlights_leave_the_dark_margin(self):
        dark = np.zeros((90, 160, 3), np.uint8)
        for change in (augment.blood, augment.highlight):
            for seed in range(5):
                self.assertEqual(int(change(dark.copy(), np.random.default_rng(seed)).max()), 0)

    def test_balancing_per_operation_lifts_what_is_seldom_there(self):
        # Hook is seldom in operation b, grasper in a; overall both are as frequent.
        picture = np.full((30, 40, 3), 90, np.uint8)
        boxes = lambda kind: np.array([[kind, 5, 5, 20, 20]], np.float32)
        frames = [Frame(f"{g}_{i}", g, None, (40, 30), boxes(0 if (g == "a") == (i < 2) else 2), picture) for g in "ab" for i in range(10)]
        alike = augment.Augmented(frames, 64, 64, 1, balance=1.0).weights
        lifted = augment.Augmented(frames, 64, 64, 1, balance=1.0, per_operation=True).weights
        np.testing.assert_allclose(alike, alike[0])
        np.testing.assert_allclose(lifted[:2].sum(), lifted[2:10].sum())
        self.assertGreater(lifted[0], 3 * lifted[5])


class Loop(unittest.TestCase):
    def test_the_schedule_follows_steps_or_minutes(self):
        self.assertEqual(Schedule(100).progress(25, 1e9), 0.25)
        self.assertEqual(Schedule(100, minutes=2).progress(99, 30), 0.25)
        self.assertAlmostEqual(Schedule(1000).factor(999, 1.0), 0.02)
        self.assertAlmostEqual(Schedule(1000).factor(0, 0.0), 1 / 200)

    def test_a_pause_lasts_as_long_as_its_file(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "quiet"
            pause = Pause(path, poll_s=0.01)
            self.assertEqual(pause.wait(), 0.0)
            path.touch()
            # Another process removes it when its measurement ends.
            with subprocess.Popen([sys.executable, "-c", f"import pathlib, time; time.sleep(0.2); pathlib.Path({str(path)!r}).unlink()"]):
                self.assertGreater(pause.wait(), 0.0)

    def test_a_checkpoint_is_not_overwritten_nor_changed_by_chance(self):
        with tempfile.TemporaryDirectory() as folder:
            Checkpoint(folder, {"epochs": 3}).write(step=5)
            self.assertEqual(Checkpoint(folder, {"epochs": 3}).read(True)["step"], 5)
            with self.assertRaisesRegex(SystemExit, "--resume"):
                Checkpoint(folder, {"epochs": 3}).read(False)
            with self.assertRaisesRegex(SystemExit, "epochs was 3, is 4"):
                Checkpoint(folder, {"epochs": 4}).read(True)

    def test_a_training_that_was_interrupted_ends_as_one_that_was_not(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            tiny_data(folder / "data")
            whole, parts = folder / "whole", folder / "parts"
            self.assertEqual(train(folder, whole).returncode, 0)
            # 4 batches an epoch: amid the first epoch, then amid the second, which is a plain one.
            for _ in range(2):
                ended = train(folder, parts, "--stop-after", "3", "--resume")
                self.assertIn("--resume goes on", ended.stderr)
            self.assertFalse((parts / "fold1.json").exists())
            self.assertIn("goes on after step 6", train(folder, parts, "--resume").stdout)
            written = [json.loads((run / "fold1.json").read_text()) for run in (whole, parts)]
            self.assertEqual(set(written[0]["frames"]), {f"b_{i}" for i in range(3)})
            self.assertEqual(written[0]["frames"], written[1]["frames"])
            states = [torch.load(run / "fold1" / "weights.pt", weights_only=True) for run in (whole, parts)]
            for name, value in states[0].items():
                self.assertTrue(torch.equal(value, states[1][name]), name)


if __name__ == "__main__":
    unittest.main()
