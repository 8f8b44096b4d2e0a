"""The segmenter; needs what test_training needs, torchvision and onnxruntime: python3 -m unittest test_masks"""

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import torch

from instruments import lite, mask_rcnn
from test_training import randomised

HERE = Path(__file__).parent


def detector_weights(folder):
    """A `lite0` detector with random weights, as train_detector.py stores it."""
    torch.manual_seed(2)
    path = Path(folder) / "weights.pt"
    torch.save(lite.LiteDetector(7, "lite0").state_dict(), path)
    return path


def rendered(folder):
    """Six frames with a bright bar each, as make_phantom_frames.py writes them."""
    rng = np.random.default_rng(3)
    for split in ("train", "val"):
        images, annotations = [], []
        for i in range(6):
            picture = rng.integers(0, 90, (64, 96, 3)).astype(np.uint8)
            x = int(rng.integers(5, 40))
            cv2.rectangle(picture, (x, 20), (x + 40, 40), (210, 210, 210), -1)
            name = f"{split}{i}.png"
            cv2.imwrite(str(folder / name), picture)
            images.append({"id": i, "width": 96, "height": 64, "file_name": name})
            outline = [[x, 20, x + 40, 20, x + 40, 40, x, 40]]
            annotations.append({"id": i, "image_id": i, "category_id": 1, "bbox": [x, 20, 40, 20], "area": 800, "segmentation": outline})
        truth = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "hook"}]}
        (folder / f"{split}.json").write_text(json.dumps(truth))


def run(script, *arguments):
    done = subprocess.run([sys.executable, "-B", HERE / script, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        raise AssertionError(done.stderr)
    return done.stdout


class Masks(unittest.TestCase):
    def test_a_segmenter_starts_from_a_detector_learns_beside_its_backbone_and_is_exported(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            start = detector_weights(folder)
            rendered(folder)
            size = ("--width", 96, "--height", 64)
            said = run("train_masks.py", "--phantom", folder, "--start", start, "--out", folder / "run", "--steps", 4, "--epoch", 2, "--batch", 2, "--threads", 1, *size)
            self.assertIn("6 phantom and 0 real frames", said)
            before, after = torch.load(start), torch.load(folder / "run" / "state.pt")["model"]
            for name, value in before.items():
                if name.startswith("backbone."):
                    self.assertTrue(torch.equal(value, after[f"pyramid.features.{name}"]), name)
            self.assertFalse(torch.equal(before["laterals.0.conv.weight"], after["pyramid.features.laterals.0.conv.weight"]), "the neck learns")
            said = run("export_masks.py", "--weights", folder / "run" / "state.pt", "--out", folder / "m.onnx", "--threads", 1, "--min-score", 0, *size)
            self.assertIn("m.onnx", said)
            outputs = [o.name for o in onnxruntime.InferenceSession(str(folder / "m.onnx"), providers=["CPUExecutionProvider"]).get_outputs()]
            self.assertEqual(outputs, ["boxes", "labels", "scores", "masks"])

    def test_a_folded_pyramid_answers_red_first_as_the_other_does_blue_first(self):
        plain, folded = randomised(mask_rcnn.Pyramid()), mask_rcnn.Pyramid().eval()
        folded.load_state_dict(plain.state_dict())
        folded.fold()
        x = torch.randint(0, 256, (1, 3, 64, 96)).float()
        with torch.no_grad():
            want, got = plain(x), folded(x.flip(1) / 255.0)
        for name, level in want.items():
            scale = float(level.abs().max())
            self.assertLess(float((level - got[name]).abs().max()), 1e-3 * scale, name)
        self.assertEqual([tuple(v.shape[-2:]) for v in want.values()], [(8, 12), (4, 6), (2, 3), (1, 2), (16, 24)])

    def test_another_file_than_a_detector_is_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "w.pt"
            torch.save({"backbone.stem.conv.weight": torch.zeros(1)}, path)
            with self.assertRaisesRegex(ValueError, "w.pt: no weights for .* not a `lite0` detector"):
                mask_rcnn.start_from(mask_rcnn.MaskRcnn(7), path)


if __name__ == "__main__":
    unittest.main()
