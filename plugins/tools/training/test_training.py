"""Networks, augmentation and the training loop; needs PyTorch, NumPy, OpenCV and onnx: python3 -m unittest test_training"""

import importlib.util
import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import cv2
import numpy as np
import torch

from instruments import adaptation, augment, folds, lite, missing_labels, networks, pictures, unlabelled
from instruments.assign import loss, padded, sim_ota
from instruments.batches import batches, blend
from instruments.data import Frame, read
from instruments.score import chosen
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
    command += ["--fold", "1", "--out", out, "--start", "none", "--network", "yolox-nano", "--epochs", "2", "--batch", "2", "--width", "96", "--height", "64"]
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

    def test_yolox_starts_from_its_own_export(self):
        x = torch.from_numpy(np.random.default_rng(1).integers(0, 256, (1, 3, 64, 96))).float()
        with tempfile.TemporaryDirectory() as folder:
            folder, model = Path(folder), randomised(networks.build("yolox-nano", 7))
            # Equal ones are stored once.
            for head in (*model.class_heads, *model.object_heads):
                head.bias.data.normal_()
            torch.save(model.state_dict(), folder / "weights.pt")
            command = [sys.executable, "-B", HERE / "export_detector.py", "--network", "yolox-nano", "--weights", folder / "weights.pt"]
            command += ["--out", folder / "m.onnx", "--width", "96", "--height", "64"]
            done = subprocess.run(command, capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            other = networks.build("yolox-nano", 7)
            networks.start(other, "yolox-nano", folder / "m.onnx")
            with torch.no_grad():
                want, got = model(x), other.eval()(x)
        for level, same in zip(want, got):
            self.assertLess(float((level - same).abs().max()), 1e-3 * float(level.abs().max()))

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
            with self.assertRaisesRegex(ValueError, "weights.pth: no weights of `yolox-nano`.*--network"):
                networks.start(networks.build("yolox-nano", 7), "yolox-nano", path)

    def test_same_padding_is_that_of_tensorflow(self):
        self.assertEqual([lite.same_padding(k, s) for k, s in ((3, 1), (3, 2), (5, 2), (1, 1))], [(1, 1, 1, 1), (0, 1, 0, 1), (1, 2, 1, 2), (0, 0, 0, 0)])


class Assignment(unittest.TestCase):
    def test_rows_in_the_middle_learn_and_one_between_two_learns_one(self):
        # A level of 4 x 1 cells of 32 px; boxes are where the truths are.
        centres, stride = torch.tensor([[16.0 + 32 * i, 16.0] for i in range(4)]), torch.full((4,), 32.0)
        truths = [torch.tensor([[1.0, 16, 16, 32, 32], [2.0, 80, 16, 32, 32]]), torch.zeros(0, 5)]
        truth, present = padded(truths)
        self.assertEqual((truth.shape, present.tolist()), ((2, 2, 5), [[True, True], [False, False]]))
        boxes = torch.tensor([[16.0, 16, 32, 32], [20.0, 16, 32, 32], [80.0, 16, 32, 32], [112.0, 16, 1, 1]]).expand(2, -1, -1)
        kinds = torch.full((2, 4, 3), -9.0)
        kinds[:, 0, 1] = kinds[:, 1, 1] = kinds[:, 2, 2] = 9.0
        learns, which, iou = sim_ota(boxes, torch.full((2, 4), 9.0), kinds, centres, stride, truth, present)
        self.assertEqual(learns[0, [0, 2]].tolist(), [True, True])
        self.assertEqual(which[0, [0, 2]].tolist(), [0, 1])
        self.assertEqual([round(v, 3) for v in iou[0, [0, 2]].tolist()], [1.0, 1.0])
        self.assertFalse(learns[1].any(), "a picture without instruments")

    def test_a_picture_is_assigned_as_it_would_be_alone(self):
        torch.manual_seed(4)
        levels = [torch.randn(3, 12, 32 // d, 48 // d) for d in (1, 2, 4)]
        truths = [torch.cat((torch.randint(0, 7, (k, 1)), torch.rand(k, 2) * 250, torch.rand(k, 2) * 90 + 10), 1).float() for k in (3, 1, 5)]
        alone = [[level[i : i + 1].clone().requires_grad_() for level in levels] for i in range(3)]
        together = [level.clone().requires_grad_() for level in levels]
        loss(together, truths).backward()
        for i, own in enumerate(alone):
            loss(own, truths[i : i + 1]).backward()
            # Both are means per assigned row; that factor is all that may differ.
            ratio = float(own[0].grad.norm() / together[0].grad[i].norm())
            for one, all_ in zip(own, together):
                self.assertLess(float((one.grad[0] - ratio * all_.grad[i]).abs().max()), 1e-4)


class Batches(unittest.TestCase):
    def samples(self):
        rng = np.random.default_rng(5)
        frames = [Frame(f"a_{i}", "a", None, (96, 54), np.array([[2, 20, 10, 60, 40]], np.float32), rng.integers(0, 255, (54, 96, 3)).astype(np.uint8)) for i in range(6)]
        return augment.Augmented(frames, 96, 64, 1, changes=augment.chosen_changes("all"))

    def test_processes_give_the_batches_of_a_thread(self):
        plan = [(0, False), (3, False), (6, True)]
        one, other = (list(batches(self.samples(), plan, 3, workers=workers)) for workers in (0, 2))
        self.assertEqual((len(one), one[0][0].shape), (3, (3, 3, 64, 96)))
        for (x, truths), (y, others) in zip(one, other):
            self.assertTrue(torch.equal(x, y))
            self.assertTrue(all(torch.equal(t, o) for t, o in zip(truths, others)))

    def test_the_average_moves_by_the_share_that_is_not_kept(self):
        old, new = torch.nn.BatchNorm2d(2), torch.nn.BatchNorm2d(2)
        new.weight.data.fill_(3.0)
        new.num_batches_tracked.fill_(7)
        blend(old, new, 0.75)
        self.assertEqual((old.weight.tolist(), int(old.num_batches_tracked)), ([1.5, 1.5], 7))


class Exports(unittest.TestCase):
    def export(self, folder, *more):
        command = [sys.executable, "-B", HERE / "export_detector.py", "--network", "yolox-nano", "--out", folder / "m.onnx", "--width", "96", "--height", "64", "--threads", "1", *more]
        return subprocess.run(command, capture_output=True, text=True)

    def calibration(self, folder, **other):
        value = {
            "format": "panoscope-calibration-1", "precision": 0.9, "limits": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7],
            # In another order than the network's.
            "classes": ["SpecimenBag", "grasper", "bipolar", "hook", "scissors", "clipper", "irrigator"],
            "score": {"temperature": 1.25, "bias": -0.5}, "objectness": {"temperature": 2.0, "bias": 0.125},
        }  # fmt: skip
        (folder / "c.json").write_text(json.dumps(value | other))
        return folder / "c.json"

    @unittest.skipUnless(importlib.util.find_spec("onnxruntime"), "no onnxruntime")
    def test_calibration_and_statistics_of_pictures_go_into_the_file(self):
        import onnx

        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            tiny_data(folder / "data")
            done = self.export(folder, "--calibration", self.calibration(folder), "--learned-from", folder / "data")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("11 pictures of 2 operations", done.stdout)
            model = onnx.load(str(folder / "m.onnx"))
            held = {p.key: p.value for p in model.metadata_props}
            self.assertEqual((held["calibration_score"], held["calibration_objectness"]), ("1.25 -0.5", "2 0.125"))
            self.assertEqual(held["class_limits"], "0.2000 0.3000 0.4000 0.5000 0.6000 0.7000 0.1000")
            self.assertEqual(held["class_limits_precision"], "0.9")
            self.assertEqual([o.name for o in model.graph.output], ["output", "features"])
            channels = 64
            self.assertEqual([d.dim_value for d in model.graph.output[1].type.tensor_type.shape.dim], [1, channels, 2, 3])
            words = held["pictures"].split()
            self.assertEqual((words[0], len(words) - 1), (pictures.FORMAT, channels * (channels + 1)))
            self.assertGreater(float(held["pictures_limit"]), 0.5)

    @unittest.skipUnless(importlib.util.find_spec("onnxruntime"), "no onnxruntime")
    def test_a_quantised_file_answers_nearly_as_the_one_in_32_bits(self):
        import onnx

        from instruments.familiar import Session

        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            tiny_data(folder / "data")
            model = randomised(networks.build("lite0", 7))
            torch.save(model.state_dict(), folder / "weights.pt")
            done = self.export(folder, "--network", "lite0", "--weights", folder / "weights.pt", "--calibration", self.calibration(folder))
            self.assertEqual(done.returncode, 0, done.stderr)
            command = [sys.executable, "-B", HERE / "quantise_detector.py", "--model", folder / "m.onnx", "--frames", folder / "data", "--frames-split", "train"]
            command += ["--out", folder / "q.onnx", "--learned-from", folder / "data", "--threads", "1"]
            done = subprocess.run(command, capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            wide, narrow = onnx.load(str(folder / "m.onnx")), onnx.load(str(folder / "q.onnx"))
            held = {p.key: p.value for p in narrow.metadata_props}
            for p in wide.metadata_props:
                self.assertEqual(held[p.key], p.value)
            self.assertIn("pictures_limit", held)
            self.assertEqual([o.name for o in narrow.graph.output], ["output", "features"])
            self.assertLess((folder / "q.onnx").stat().st_size, 0.4 * (folder / "m.onnx").stat().st_size)
            # What processors without VNNI add in 16 bits: the products of two neighbouring weights with up to 255.
            for tensor in narrow.graph.initializer:
                weight = onnx.numpy_helper.to_array(tensor).astype(int)
                if tensor.data_type == onnx.TensorProto.INT8 and weight.ndim == 4 and weight.shape[1] > 1:
                    row = weight.transpose(0, 2, 3, 1).reshape(len(weight), -1)
                    pairs = np.pad(row, ((0, 0), (0, row.shape[1] % 2))).reshape(len(row), -1, 2)
                    for sign in (1, -1):
                        self.assertLess(255 * int(np.maximum(sign * pairs, 0).sum(2).max()), 1 << 15, tensor.name)
            # Margins inside the backbone would be computed in 32 bits between nodes in 8.
            self.assertLessEqual(sum(n.op_type == "Pad" for n in narrow.graph.node), 1)
            x = cv2.imread(str(folder / "data" / "images" / "train" / "a_0.jpg")).astype(np.float32)
            x = np.pad(x, ((0, 10), (0, 0), (0, 0)), constant_values=114).transpose(2, 0, 1)[None]
            want, got = Session(folder / "m.onnx", 1)(x), Session(folder / "q.onnx", 1)(x)
            off = np.abs(got - want)
            self.assertGreater(float(off.max()), 0.0)
            self.assertLess(float(np.median(off[..., :4])), 0.1 * float(want[..., :4].std()))
            self.assertLess(float(np.median(off[..., 4:])), 0.1)
            again = subprocess.run([*command[:4], folder / "q.onnx", *command[5:]], capture_output=True, text=True)
            self.assertIn("would overwrite", again.stderr)

    @unittest.skipUnless(importlib.util.find_spec("onnxruntime"), "no onnxruntime")
    def test_a_file_learns_its_pictures_and_answers_as_before(self):
        import onnxruntime

        x = np.random.default_rng(1).integers(0, 256, (1, 3, 224, 384)).astype(np.float32)
        for name, outputs, x in (("instruments", ["output"], x), ("instrument_masks", ["boxes", "scores", "masks"], x / 255)):
            shipped = HERE.parent / "models" / f"{name}.onnx"
            with self.subTest(name), tempfile.TemporaryDirectory() as folder:
                folder = Path(folder)
                tiny_data(folder / "data")
                command = [sys.executable, "-B", HERE / "know_pictures.py", "--model", shipped, "--learned-from", folder / "data", "--threads", "1"]
                command += ["--out", folder / "m.onnx", "--compare", folder / "data" / "images" / "train"]
                done = subprocess.run(command, capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertRegex(done.stdout, r"train: 11 pictures, median 0\.\d+ of the limit")
                answers = []
                for path in (shipped, folder / "m.onnx"):
                    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
                    answers.append(session.run(outputs, {"images": x}))
                for before, after in zip(*answers, strict=True):
                    self.assertTrue((before == after).all(), "its answers stay to the last bit")
                again = subprocess.run(command, capture_output=True, text=True)
                self.assertIn("is not overwritten", again.stderr)

    def test_a_file_that_is_no_calibration_is_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            for other, part in (({"format": "x"}, "its format is `x`"), ({"classes": ["needle"] * 7}, "grasper"), ({"score": 3}, "c.json")):
                done = self.export(folder, "--calibration", self.calibration(folder, **other))
                self.assertNotEqual(done.returncode, 0)
                self.assertIn(part, done.stderr)
                self.assertFalse((folder / "m.onnx").exists())

    def test_unlikeness_is_as_the_node_computes_it(self):
        # The numbers of the test in src/pictures.rs.
        features = np.array([[[3, 5, 99], [99, 99, 99]], [[4, 8, 99], [99, 99, 99]]], float)
        row = pictures.mean_features(features, (70, 40))
        np.testing.assert_allclose(row, [4, 6])
        found = pictures.Statistics(np.array([1.0, 2.0]), np.array([[2.0, 0.0], [0.0, 0.5]]), 2.0)
        np.testing.assert_allclose(found.unlikeness(row) / found.limit, 20**0.5 / 2)
        self.assertEqual(found.metadata()["pictures"], "panoscope-pictures-1 1 2 2 0 0 0.5")

    def test_pictures_of_another_world_are_above_the_limit_and_an_operation_left_out_is_not(self):
        rng = np.random.default_rng(5)
        # Five operations, each with its own shift along three of twenty directions.
        world = rng.normal(size=(20, 20)) * 0.1
        world[:3] *= 10
        draw = lambda shift: shift + rng.normal(size=(200, 20)) @ world
        operations = [rng.normal(size=20) @ world for _ in range(5)]
        rows, groups = np.concatenate([draw(o) for o in operations]), np.repeat(np.arange(5), 200)
        found = pictures.Statistics.with_limit(rows, groups)
        self.assertLess(float((found.unlikeness(draw(rng.normal(size=20) @ world)) > found.limit).mean()), 0.1)
        self.assertGreater(float((found.unlikeness(draw(rng.normal(size=20) * 3)) > found.limit).mean()), 0.95)


def footage(folder, count=12):
    """Frames of a bright bar that moves over noise, and a video of them."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(3)
    video = cv2.VideoWriter(str(folder.parent / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (96, 54))
    for i in range(count):
        picture = rng.integers(0, 120, (54, 96, 3)).astype(np.uint8)
        cv2.rectangle(picture, (5 * i, 20), (5 * i + 30, 40), (200, 200, 200), -1)
        cv2.imwrite(str(folder / f"x_{i:03d}.png"), picture)
        video.write(picture)
    video.release()
    # The same picture again shows nothing new.
    cv2.imwrite(str(folder / f"x_{count:03d}.png"), picture)


class Predictions(unittest.TestCase):
    def test_boxes_keep_their_objectness_in_the_file(self):
        # Centre and size; the second box is the first one again, weaker, the third another tool of another class.
        boxes = np.array([[50, 50, 20, 20], [51, 50, 20, 20], [100, 40, 30, 10]], np.float32)
        objectness, kinds = np.array([0.9, 0.8, 0.5], np.float32), np.array([[0.8, 0.1], [0.7, 0.1], [0.004, 0.6]], np.float32)
        rows = chosen(boxes, objectness, kinds, 2.0, 0.01, 0.5)
        self.assertEqual(rows.shape, (3, 7))
        np.testing.assert_allclose(rows[0], [0, 0.72, 20, 20, 30, 30, 0.9], rtol=1e-6)
        # The weaker class of the first place is a row of its own; its objectness is the place's.
        np.testing.assert_allclose(sorted(r[6] for r in rows if r[0] == 1), [0.5, 0.9], rtol=1e-6)
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "folds.toml").write_text(FOLDS)
            path = folds.write_predictions(folder, folds.read(Path(folder) / "folds.toml"), 1, ["a", "b"], {}, {"b_0": rows, "b_1": []})
            stored = json.loads(path.read_text())["frames"]
        self.assertEqual((stored["b_0"][0], stored["b_1"]), ([0, 0.72, 20.0, 20.0, 30.0, 30.0, 0.9], []))


class Adapting(unittest.TestCase):
    def adapt(self, folder, out, *more):
        command = [sys.executable, "-B", HERE / "adapt_detector.py", "--frames", folder / "frames", "--out", out, "--width", "96", "--height", "64"]
        command += ["--steps", "6", "--batch", "2", "--threads", "1", "--confidence", "0.02", "--unsure", "0.01", *more]
        return subprocess.run(command, capture_output=True, text=True)

    def test_an_adaptation_reports_what_changed_and_overwrites_nothing(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            footage(folder / "frames")
            tiny_data(folder / "data")
            weights_of = HERE / "weights" / "instruments.pt"
            start = weights_of.read_bytes()
            done = self.adapt(folder, folder / "out", "--source", folder / "data", "--source-split", "train", "--rate", "0.01", "--keep", "0.5")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("10 frames to adapt on, 2 for the report, 11 labelled", done.stdout)
            report = json.loads((folder / "out" / "report.json").read_text())
            self.assertEqual((report["frames"], report["steps"], set(report["source_map50"])), (2, 6, {"before", "after"}))
            self.assertEqual(len(report["classes"]), 7)
            for name in ("report.md", "changes.png", "adapted.onnx"):
                self.assertTrue((folder / "out" / name).exists(), name)
            self.assertIn("| grasper |", (folder / "out" / "report.md").read_text())
            weights = torch.load(folder / "out" / "adapted.pt", weights_only=True)
            fresh = networks.build("lite0", 7)
            networks.start(fresh, "lite0", weights_of)
            moved = [k for k, v in fresh.state_dict().items() if not torch.equal(v, weights[k])]
            self.assertTrue([k for k in moved if k.endswith("conv.weight")])
            self.assertFalse([k for k in moved if "running" in k], "statistics of normalisations stay")
            again = self.adapt(folder, folder / "out", "--resume")
            self.assertIn("is not overwritten", again.stderr)
            self.assertEqual(weights_of.read_bytes(), start)

    def test_one_that_was_interrupted_ends_as_one_that_was_not(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            footage(folder / "frames")
            self.assertEqual(self.adapt(folder, folder / "whole").returncode, 0)
            self.assertIn("interrupted after step 2", self.adapt(folder, folder / "parts", "--stop-after", "2").stderr)
            self.assertIn("--resume goes on with it", self.adapt(folder, folder / "parts").stderr)
            self.assertIn("seed was 1, is 2", self.adapt(folder, folder / "parts", "--resume", "--seed", "2").stderr)
            self.assertIn("goes on after step 2", self.adapt(folder, folder / "parts", "--resume").stdout)
            states = [torch.load(folder / run / "adapted.pt", weights_only=True) for run in ("whole", "parts")]
            for name, value in states[0].items():
                self.assertTrue(torch.equal(value, states[1][name]), name)

    def test_frames_come_from_folders_and_videos(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            footage(folder / "frames")
            found = unlabelled.read([folder / "frames", folder / "v.avi"], 48, every_s=0.08)
            names = [f.name for f in found]
            self.assertEqual(names[:12], [f"x_{i:03d}" for i in range(12)], "without the one that shows nothing new")
            self.assertEqual(names[12:], [f"v_{i:06d}" for i in range(0, 12, 2)])
            self.assertEqual((found[0].picture.shape, len({f.group for f in found})), ((27, 48, 3), 2))
            learned, held = unlabelled.aside(list(range(100)), 0.2)
            self.assertEqual((len(learned), held), (80, list(range(80, 100))))
            self.assertEqual(unlabelled.aside(list(range(10)), 0.2)[1], [8, 9])
            (folder / "no.avi").write_bytes(b"no video")
            with self.assertRaisesRegex(SystemExit, "no.avi: neither"):
                unlabelled.read([folder / "no.avi"], 48)

    def test_half_believed_boxes_are_covered_and_sure_ones_learned(self):
        row = lambda kind, p, x: [kind, p, x, 10, x + 20, 30, 1.0]
        rows = np.array([row(2, 0.9, 10), row(1, 0.4, 12), row(3, 0.4, 60), row(4, 0.05, 30)], np.float32)
        learn, hide = unlabelled.pseudo(rows, 0.7, 0.2)
        np.testing.assert_allclose(learn, [[2, 10, 10, 30, 30]])
        np.testing.assert_allclose(hide, [[60, 10, 80, 30]])
        picture = np.random.default_rng(1).integers(0, 255, (54, 96, 3)).astype(np.uint8)
        seen = unlabelled.covered(picture, hide, learn)
        self.assertEqual(float(seen[10:30, 60:80].std(axis=(0, 1)).max()), 0.0)
        self.assertTrue((seen[10:30, 10:30] == picture[10:30, 10:30]).all() and (seen[:, :60] == picture[:, :60]).all())

    def test_a_curve_goes_both_ways(self):
        curve = unlabelled.Curve(1.7, -0.4)
        self.assertAlmostEqual(curve.score(float(curve.probability(0.3))), 0.3, places=6)

    def test_reports_warn_of_changes_that_go_too_far(self):
        row = lambda kind, p, x: np.array([[kind, p, x, 10, x + 20, 30, 1.0]], np.float32)
        same = adaptation.summary([row(0, 0.9, 10)] * 20, [row(0, 0.85, 11)] * 20, ["a", "b"])
        self.assertEqual((same["boxes"]["alike"], same["agreement"], adaptation.warnings(same)), (20, 1.0, []))
        other = adaptation.summary([row(0, 0.9, 10)] * 20, [row(1, 0.5, 11)] * 20, ["a", "b"])
        self.assertEqual(other["boxes"], {"alike": 0, "renamed": 20, "only_before": 0, "only_after": 0})
        found = " ".join(adaptation.warnings(other, {"before": 0.8, "after": 0.6}))
        for part in ("only 0 %", "a: 20 boxes before, 0 after", "b: 0 boxes", "0.90 to 0.50", "forgot"):
            self.assertIn(part, found)
        none = adaptation.summary([row(0, 0.9, 10)] * 3, [np.zeros((0, 7), np.float32)] * 3, ["a", "b"])
        self.assertIn("nothing is found any more", adaptation.warnings(none))


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


class MissingLabels(unittest.TestCase):
    def test_missing_labels_are_learned_from_and_not_scored(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            tiny_data(folder / "data")
            labels = folder / "missing.toml"
            labels.write_text("".join(f'[[missing]]\nframe = "{name}"\nclass = "grasper"\nbox = [2, 3, 200, 20]\n' for name in ("a_1", "b_1")))
            done = train(folder, folder / "out", "--missing-labels", labels, "--stop-after", "1")
            self.assertIn("1 labels added", done.stdout, done.stderr)
            frames = read(folder / "data", "train")
            self.assertEqual(missing_labels.add(frames, missing_labels.read(labels)), 2)
            added = next(f for f in frames if f.name == "a_1")
            np.testing.assert_allclose(added.boxes[1], [0, 2, 3, 96, 20])

    def test_a_file_that_is_wrong_is_named_with_its_entry(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "missing.toml"
            for text, said in (
                ("x = 1", "no entry"),
                ("x = ", "not TOML"),
                ('[[missing]]\nframe = "a"\nclass = "spoon"\nbox = [1, 2, 3, 4]', "entry 1"),
                ('[[missing]]\nframe = "a"\nclass = "hook"\nbox = [3, 2, 1, 4]', "x0 < x1"),
            ):
                path.write_text(text)
                with self.assertRaisesRegex(missing_labels.MissingLabelsError, said):
                    missing_labels.read(path)

    def test_the_file_that_ships_is_read(self):
        self.assertEqual(sum(map(len, missing_labels.read(missing_labels.SHIPPED).values())), 43)


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
            # A training that has ended writes its predictions again.
            (parts / "fold1.json").unlink()
            self.assertEqual(train(folder, parts, "--resume").returncode, 0)
            self.assertEqual(json.loads((parts / "fold1.json").read_text())["frames"], written[0]["frames"])
            states = [torch.load(run / "fold1" / "weights.pt", weights_only=True) for run in (whole, parts)]
            for name, value in states[0].items():
                self.assertTrue(torch.equal(value, states[1][name]), name)

    def test_what_each_change_costs_is_measured_on_frames_kept_out(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            tiny_data(folder / "data")
            (folder / "run" / "fold1").mkdir(parents=True)
            weights = folder / "run" / "fold1" / "weights.pt"
            torch.save(randomised(networks.build("yolox-nano", 7)).state_dict(), weights)
            command = [sys.executable, "-B", HERE / "measure_changes.py", "--data", folder / "data", "--folds", folder / "data" / "folds.toml"]
            command += ["--fold", "1", "--weights", weights, "--network", "yolox-nano", "--width", "96", "--height", "64", "--threads", "1"]
            done = subprocess.run(command, capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("on 3 frames of fold 1", done.stdout)
            self.assertIn("| change | run/fold1 |", done.stdout)
            rows = [line.split("|")[1].strip(" `") for line in done.stdout.splitlines() if line.startswith("| ")]
            self.assertEqual(rows[1:], ["none", *augment.NAMES])
            command[command.index("1")] = "4"
            wrong = subprocess.run(command, capture_output=True, text=True)
            self.assertIn("there is no fold 4; there are 1, 2", wrong.stderr)


if __name__ == "__main__":
    unittest.main()
