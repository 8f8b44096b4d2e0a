"""What is no instrument; needs NumPy, OpenCV, onnx, onnxruntime and PyTorch: python3 -m unittest test_empty"""

import tempfile
import unittest
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

from instruments import empty, opinion
from instruments.cavities import frame
from make_empty_frames import part_without

MODELS = Path(__file__).parent.parent / "models"


class Empty(unittest.TestCase):
    def test_an_opinion_lowers_scores_by_what_it_says_and_changes_nothing_else(self):
        rng = np.random.default_rng(1)
        for name in ("instruments", "instrument_masks"):
            model = empty.without_opinion(MODELS / f"{name}.onnx")
            self.assertLess(len(model.graph.node), len(onnx.load(str(MODELS / f"{name}.onnx")).graph.node))
            reader = empty.Reader(MODELS / f"{name}.onnx", 1)
            picture = frame(8, *reader.size)
            found = reader(picture)
            # A doubt of 0, and one of two layers with random weights.
            for scale in (0.0, 0.05):
                changed = onnx.ModelProto()
                changed.CopyFrom(model)
                layers = []
                for number, (tap, (features, _, _)) in enumerate(zip(reader.taps, found)):
                    inner = scale * rng.normal(size=(empty.INNER, features.shape[1])), scale * rng.normal(size=empty.INNER)
                    layers.append((inner, (scale * rng.normal(size=(1, empty.INNER)), np.array([0.5 if scale else -60.0]))))
                    empty.insert(changed.graph, tap, number, layers[-1])
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / "changed.onnx"
                    onnx.checker.check_model(changed)
                    onnx.save(changed, str(path))
                    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
                before = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
                x = picture.astype(np.float32).transpose(2, 0, 1)[None]
                x = x if reader.is_detector else np.ascontiguousarray(x[:, ::-1]) / np.float32(255)
                old, new = (dict(zip([o.name for o in s.get_outputs()], s.run(None, {"images": x}))) for s in (before, session))
                np.testing.assert_allclose(new["features"], old["features"], atol=1e-5)
                if scale == 0.0:
                    for key in old:
                        np.testing.assert_allclose(new[key], old[key], atol=1e-4, err_msg=f"{name} {key}")
                elif reader.is_detector:
                    np.testing.assert_allclose(new["output"][..., :4], old["output"][..., :4], atol=1e-4)
                    np.testing.assert_allclose(new["output"][..., 5:], old["output"][..., 5:], atol=1e-5)
                    self.assertTrue((new["output"][..., 4] <= old["output"][..., 4] + 1e-5).all())
                    # The score of the surest cell of a stride, by hand.
                    tap = int(np.argmax([len(f[0]) for f in found]))
                    features, logits, _ = found[tap]
                    doubt = opinion.doubt_of(features, layers[tap])
                    want = 1 / (1 + np.exp(doubt - logits[:, 0]))
                    self.assertTrue(all(np.abs(new["output"][0, :, 4] - value).min() < 1e-4 for value in want))
                else:
                    self.assertLess(new["scores"].max(initial=0), old["scores"].max(initial=0))

    def test_a_box_is_empty_or_not_by_what_covers_it(self):
        ids = np.zeros((40, 60), np.uint8)
        ids[10:20, 20:40] = 2
        boxes = np.array([[20, 10, 40, 20], [0, 0, 10, 10], [10, 10, 30, 20], [50, 30, 90, 70]], float)
        np.testing.assert_allclose(empty.covered(ids, boxes), [1, 0, 0.5, 0])

    def test_an_opinion_learns_what_separates_and_keeps_the_rest(self):
        rng = np.random.default_rng(2)
        is_some = rng.random(4000) < 0.5
        features = rng.normal(size=(4000, 6)).astype(np.float32)
        features[:, 2] += np.where(is_some, 2.5, -2.5)
        weights = opinion.learn((features, np.full(4000, 1.5, np.float32), is_some), epochs=25, batch=512)
        doubt = opinion.doubt_of(features, weights)
        self.assertLess(np.median(doubt[is_some]), 0.1)
        self.assertGreater(np.median(doubt[~is_some]), 1.5)

    def test_drawn_cavities_are_the_same_for_the_same_seed(self):
        self.assertTrue((frame(3, 96, 64) == frame(3, 96, 64)).all())
        self.assertGreater(np.abs(frame(3, 96, 64).astype(int) - frame(4, 96, 64)).mean(), 2)

    def test_a_part_of_a_frame_avoids_labels_and_metal(self):
        picture = np.zeros((180, 320, 3), np.uint8)
        picture[:] = (60, 70, 170)
        picture[:, :60] = (130, 130, 130)
        label = np.array([[200, 0, 320, 180]], float)
        part = part_without(picture, (320, 180), label, np.random.default_rng(1))
        self.assertEqual(np.unique(part.reshape(-1, 3), axis=0).tolist(), [[60, 70, 170]])
        self.assertIsNone(part_without(picture, (320, 180), np.array([[60, 0, 320, 180]], float), np.random.default_rng(1)))


if __name__ == "__main__":
    unittest.main()
