"""Tips of instruments; needs NumPy, OpenCV, onnx, onnxruntime and PyTorch: python3 -m unittest test_tips"""

import tempfile
import tomllib
import unittest
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from instruments import tips
from instruments.cavities import frame
from instruments.tip_learning import Map, Windows, learn, targets
from know_tips import LISTS, tips_of
from make_phantom_frames import tips_of as rendered_tips

MODEL = Path(__file__).parent.parent / "models" / "instruments.onnx"


class Tips(unittest.TestCase):
    def test_a_map_of_tips_is_what_was_learned_and_changes_nothing_else(self):
        reader = tips.Reader(MODEL, 1)
        picture = frame(8, *tips.INPUT)
        fine, coarse = reader(picture)
        torch.manual_seed(1)
        layers = Map(len(fine), len(coarse)).eval()
        weights = {key: value.numpy() for key, value in layers.state_dict().items()}
        model = tips.without_tips(MODEL)
        before = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        tips.insert(model.graph, weights)
        onnx.checker.check_model(model)
        after = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        x = {"images": picture.astype(np.float32).transpose(2, 0, 1)[None]}
        old, (*new, found) = before.run(None, x), after.run(None, x)
        self.assertEqual(len(old), len(new))
        for a, b in zip(old, new):
            np.testing.assert_array_equal(a, b)
        with torch.no_grad():
            score, *off = layers(torch.from_numpy(fine)[None], torch.from_numpy(coarse)[None])[0].numpy()
        # A cell is 8 px.
        np.testing.assert_allclose(found[0, 0], 1 / (1 + np.exp(-score)), atol=1e-4)
        y, x = np.mgrid[: score.shape[0], : score.shape[1]]
        np.testing.assert_allclose(found[0, 1], 8 * (x + 0.5 + off[0]), atol=0.02)
        np.testing.assert_allclose(found[0, 2], 8 * (y + 0.5 + off[1]), atol=0.02)

    def test_the_shipped_file_without_its_tips_has_nothing_left_of_them(self):
        shipped, plain = onnx.load(str(MODEL)), tips.without_tips(MODEL)
        self.assertEqual([o.name for o in shipped.graph.output], ["output", "features", "tips"])
        self.assertEqual([o.name for o in plain.graph.output], ["output", "features"])
        self.assertFalse([n.name for n in plain.graph.node if "tips" in n.name + "".join(n.output)])
        self.assertFalse([t.name for t in plain.graph.initializer if "tips" in t.name])

    def test_tips_are_learned_where_they_are(self):
        # A channel of the features is bright where a tip is.
        rng = np.random.default_rng(1)
        rows, columns = tips.INPUT[1] // 8, tips.INPUT[0] // 8
        fine, coarse = rng.normal(size=(96, 3, rows, columns)), rng.normal(size=(96, 2, rows // 2, columns // 2))
        places = np.full((96, tips.MAX_TIPS, 2), np.nan, np.float32)
        places[:, 0] = rng.uniform((30, 30), (tips.INPUT[0] - 30, tips.INPUT[1] - 30), (96, 2))
        for values, place in zip(fine, places[:, 0]):
            values[0] += 6 * targets(place[None])[0]
        windows = Windows(fine.astype(np.float32), coarse.astype(np.float32), places, np.zeros((96, rows, columns), np.uint8), 1)
        weights = learn(windows, 60)
        layers = Map(3, 2)
        layers.load_state_dict({key: torch.from_numpy(np.float32(value)) for key, value in weights.items()})
        with torch.no_grad():
            score = layers(*(torch.from_numpy(np.float32(v)) for v in (fine, coarse)))[:, 0].numpy()
        best = [np.unravel_index(np.argmax(s), s.shape) for s in score]
        off = [np.hypot(8 * x + 4 - place[0], 8 * y + 4 - place[1]) for (y, x), place in zip(best, places[:, 0])]
        self.assertLess(np.median(off), 8.0)

    def test_samples_move_tips_with_the_picture(self):
        # A white square on gray: the tip is its middle, wherever the sample puts it.
        picture, ids = np.full((tips.HEIGHT, tips.WIDTH, 3), 90, np.uint8), np.zeros((tips.HEIGHT, tips.WIDTH), np.uint8)
        picture[170:190, 310:330], ids[170:190, 310:330] = 255, 1
        rendered = [tips.Tipped(picture, ids, [(1, np.array([319.5, 179.5]), True)], [])]
        samples = tips.Samples(rendered, [], [], 3)
        off = []
        for number in range(40):
            out, found, _ = samples.sample(number)
            bright = out[:216].min(2) >= np.percentile(out[:216].min(2), 99.9)
            if np.isfinite(found[0, 0]):
                ys, xs = bright.nonzero()
                off.append(np.hypot(xs.mean() - found[0, 0], ys.mean() - found[0, 1]))
        self.assertGreater(len(off), 20)
        self.assertLess(np.median(off), 6.0)

    def test_lists_of_tips_keep_operations_apart(self):
        learned, held_out = tips_of(LISTS, ("agreed", "hand")), tips_of(LISTS, ("evaluation",))
        group = lambda names: {name.split("_")[0] for name in names}
        self.assertFalse(group(learned) & group(held_out))
        self.assertEqual(group(held_out), {"v08", "v09", "v10"})
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "tips.toml"
            path.write_text('hand = [["v01_1", 0.5, 1.5]]\n')
            self.assertRaises(SystemExit, tips_of, path, ("hand",))
        self.assertTrue(tomllib.loads(LISTS.read_text())["data"])

    def test_tips_of_the_phantom_are_projected(self):
        tip = lambda x, y, z: {"tip": {"u_px": 750 * x / z + 319.5, "v_px": 750 * y / z + 179.5, "xyz_mm": [x, y, z]}}
        row = {"track_id": 2, "seen": 1, "x_mm": 4.0, "y_mm": -8.0, "z_mm": 40.0}
        behind = {"track_id": 3, "seen": 0, "x_mm": 4.0, "y_mm": 8.0, "z_mm": -1.0}
        found = rendered_tips([tip(1, 2, 50), tip(-3, 5, 60), {}], [{"seq": 7, "table": [row, behind]}])
        self.assertEqual(found, {(7, 2): [394.5, 29.5, 1]})
        self.assertEqual(rendered_tips([{}], [{"seq": 7, "table": [row]}]), {})


if __name__ == "__main__":
    unittest.main()
