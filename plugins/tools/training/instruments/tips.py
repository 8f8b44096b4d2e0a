"""Tips of instruments: samples with known tips, and a map of tips in an exported detector, computed from the features that it has anyway."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime
from onnx import helper, numpy_helper

from .augment import lab_statistics, light, photometric, transfer_colour
from .outlines import run_lengths

#: Size at which samples are composed, of the network's input, and of its map of tips.
WIDTH, HEIGHT = 640, 360
INPUT = (384, 224)
CELL = 8
#: Maximum number of tips in a sample.
MAX_TIPS = 8
#: What the map is computed from: features of stride 8, and of stride 16.
FEATURES = [
    "/stages.2/stages.2.1/Add_output_0",
    "/top_down3/merge/merge.1/Relu_output_0",
    "/box_towers.0/box_towers.0.1/box_towers.0.1.1/box_towers.0.1.1.1/Relu_output_0",
    "/class_towers.0/class_towers.0.1/class_towers.0.1.1/class_towers.0.1.1.1/Relu_output_0",
    "/bottom_up4/merge/merge.1/Relu_output_0",
]
#: Shares of the samples: rendered frames, rendered instruments in pictures without any; the rest are real frames.
RENDERED, PASTED = 0.35, 0.25
OUTPUT = "tips"


@dataclass
class Tipped:
    """A frame with tips: `tools` are number in `ids`, position of the tip, whether it is seen; `doubtful` boxes may have tips nobody marked."""

    picture: np.ndarray
    ids: np.ndarray
    tools: list
    doubtful: list


def read_rendered(folder):
    """Frames of `make_phantom_frames.py` (split `train`) with the tips that they show."""
    folder = Path(folder)
    truth = json.loads((folder / "train.json").read_text())
    of = {}
    for a in truth["annotations"]:
        of.setdefault(a["image_id"], []).append(a)
    frames = []
    for i in truth["images"]:
        picture = cv2.imread(str(folder / i["file_name"]))
        if picture is None:
            raise ValueError(f"{folder / i['file_name']}: not a picture that can be read")
        ids, tools = np.zeros(picture.shape[:2], np.uint8), []
        scale = np.array([WIDTH / picture.shape[1], HEIGHT / picture.shape[0]])
        for number, a in enumerate(of.get(i["id"], []), 1):
            ids[run_lengths(a["segmentation"]["counts"], *a["segmentation"]["size"]) > 0] = number
            if "tip" in a:
                tools.append((number, scale * a["tip"][:2], bool(a["tip"][2])))
        size = (WIDTH, HEIGHT)
        frames.append(Tipped(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), cv2.resize(ids, size, interpolation=cv2.INTER_NEAREST), tools, []))
    return frames


def read_real(frames, tips):
    """Of real frames with boxes those with tips (`tips`: frame to positions as shares of width and height)."""
    found = []
    for f in frames:
        if f.name not in tips:
            continue
        picture = cv2.imread(str(f.path))
        if picture is None:
            raise ValueError(f"{f.path}: not a picture that can be read")
        h, w = picture.shape[:2]
        rows = min(HEIGHT, round(h * WIDTH / w))
        fitted = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        fitted[:rows] = cv2.resize(picture, (WIDTH, round(h * WIDTH / w)), interpolation=cv2.INTER_AREA)[:rows]
        scale = WIDTH / f.size[0]
        tools = [(0, np.array([x * WIDTH, y * h * WIDTH / w]), True) for x, y in tips[f.name]]
        found.append(Tipped(fitted, np.zeros((HEIGHT, WIDTH), np.uint8), tools, [b[1:] * scale for b in f.boxes]))
    return found


def covering(picture, rng):
    """A part of any picture that fills a sample."""
    h, w = picture.shape[:2]
    scale = max(WIDTH / w, HEIGHT / h)
    picture = cv2.resize(picture, (int(np.ceil(w * scale)), int(np.ceil(h * scale))))
    y, x = int(rng.integers(picture.shape[0] - HEIGHT + 1)), int(rng.integers(picture.shape[1] - WIDTH + 1))
    return picture[y : y + HEIGHT, x : x + WIDTH].copy()


class Samples:
    """Endless, seeded samples: a picture of the network's size, the tips in it (px), and for each cell whether it may have a tip nobody marked."""

    def __init__(self, rendered, real, empty, seed):
        self.rendered, self.real, self.empty, self.seed = rendered, real, empty, seed
        self.statistics = [lab_statistics(f.picture) for f in real] or [lab_statistics(f.picture) for f in rendered]
        self.donors = [(f, t) for f in rendered for t in f.tools if t[2] and (f.ids == t[0]).sum() > 400]

    def _paste(self, picture, ids, tools, own, rng):
        if not self.donors:
            return picture, ids, tools
        f, (number, tip, _) = self.donors[int(rng.integers(len(self.donors)))]
        donor, mask = f.picture, (f.ids == number).astype(np.uint8)
        if rng.random() < 0.8:
            donor = transfer_colour(donor, lab_statistics(donor), own, rng.uniform(0.3, 0.9))
        if rng.random() < 0.5:
            donor = light(donor, rng)
        # Flips and a growth about the middle leave the entry at or beyond the rim.
        turn = rng.uniform(1.0, 1.7) * np.diag([-1.0 if rng.random() < 0.5 else 1.0, -1.0 if rng.random() < 0.4 else 1.0])
        middle = np.array([WIDTH, HEIGHT]) / 2
        shift = middle - turn @ middle + rng.uniform(-0.12, 0.12, 2) * [WIDTH, HEIGHT]
        matrix = np.hstack((turn, shift[:, None]))
        donor = cv2.warpAffine(donor, matrix, (WIDTH, HEIGHT))
        mask = cv2.warpAffine(mask, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_NEAREST)
        if mask.sum() < 300 or ((ids > 0) & (mask > 0)).sum() > 0.4 * mask.sum():
            return picture, ids, tools
        soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.5, 1.3))[..., None]
        ids = ids.copy()
        new = int(ids.max()) + 1
        ids[mask > 0] = new
        return (picture * (1 - soft) + donor * soft).astype(np.uint8), ids, [*tools, (new, turn @ tip + shift, True)]

    def _composed(self, rng):
        draw = rng.random()
        if draw >= RENDERED + PASTED and self.real:
            f = self.real[int(rng.integers(len(self.real)))]
            return f.picture, f.ids, f.tools, f.doubtful, lab_statistics(f.picture)
        if draw >= RENDERED and self.empty:
            picture = covering(cv2.imread(str(self.empty[int(rng.integers(len(self.empty)))])), rng)
            ids, tools, own, pasted = np.zeros((HEIGHT, WIDTH), np.uint8), [], lab_statistics(picture), int(rng.integers(1, 4))
        else:
            f = self.rendered[int(rng.integers(len(self.rendered)))]
            picture, ids, tools, own, pasted = f.picture, f.ids, f.tools, lab_statistics(f.picture), int(rng.random() < 0.25)
            if rng.random() < 0.7:
                other = self.statistics[int(rng.integers(len(self.statistics)))]
                picture, own = transfer_colour(picture, own, other, rng.uniform(0.5, 1.0)), other
        for _ in range(pasted):
            picture, ids, tools = self._paste(picture, ids, tools, own, rng)
        return picture, ids, tools, [], own

    def sample(self, number):
        rng = np.random.default_rng((self.seed, number))
        picture, ids, tools, doubtful, own = self._composed(rng)
        inside = np.ones((HEIGHT, WIDTH), np.uint8)
        if not doubtful and rng.random() < 0.35:
            centre = (int(WIDTH * rng.uniform(0.42, 0.58)), int(HEIGHT * rng.uniform(0.42, 0.58)))
            inside = cv2.circle(0 * inside, centre, int(WIDTH * rng.uniform(0.3, 0.55)), 1, -1)
            picture = picture * inside[..., None]
        angle = rng.uniform(-25, 25) if rng.random() < 0.6 else 0.0
        grow = np.exp(rng.uniform(*np.log((0.75, 1.8)))) if rng.random() < 0.7 else 1.0
        matrix = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), angle, grow)
        for axis, size, share in ((0, WIDTH, 0.5), (1, HEIGHT, 0.25)):
            if rng.random() < share:
                matrix[axis] = -matrix[axis]
                matrix[axis, 2] += size
            matrix[axis, 2] += rng.uniform(-0.15, 0.15) * size
        matrix *= INPUT[0] / WIDTH
        shown = HEIGHT * INPUT[0] // WIDTH
        out = np.full((INPUT[1], INPUT[0], 3), 114, np.uint8)
        part = cv2.warpAffine(picture, matrix, (INPUT[0], shown), borderValue=(0, 0, 0) if rng.random() < 0.6 else (114, 114, 114))
        other = self.statistics[int(rng.integers(len(self.statistics)))]
        out[:shown] = photometric(part, rng, own, other) if rng.random() < 0.6 else light(part, rng)
        return out, *self._marks(ids, tools, doubtful, inside, matrix, shown)

    @staticmethod
    def _marks(ids, tools, doubtful, inside, matrix, shown):
        rows, columns = INPUT[1] // CELL, INPUT[0] // CELL
        unsure, marked = np.zeros((rows, columns), np.uint8), np.zeros((rows, columns), np.uint8)
        move = lambda points: np.atleast_2d(points) @ matrix[:, :2].T + matrix[:, 2]
        for x0, y0, x1, y1 in doubtful:
            mx, my = 0.1 * (x1 - x0), 0.1 * (y1 - y0)
            corners = np.array([[x0 - mx, y0 - my], [x1 + mx, y0 - my], [x1 + mx, y1 + my], [x0 - mx, y1 + my]])
            cv2.fillPoly(unsure, [np.round(move(corners) / CELL - 0.5).astype(np.int32)], 1)
        tips = np.full((MAX_TIPS, 2), np.nan, np.float32)
        for number, tip, is_seen in tools:
            (x, y), (column, row) = move(tip)[0], np.round(tip).astype(int)
            if not (2 <= x < INPUT[0] - 2 and 2 <= y < shown - 2):
                continue
            if 0 <= column < WIDTH and 0 <= row < HEIGHT:
                is_seen = is_seen and ids[row, column] in (0, number)
                if not inside[row, column]:
                    continue
            cell = (int(x // CELL), int(y // CELL))
            free = np.isnan(tips[:, 0]).nonzero()[0]
            if not is_seen:
                cv2.circle(unsure, cell, 2, 1, -1)
            elif len(free):
                tips[free[0]] = x, y
                if doubtful:
                    cv2.circle(marked, cell, 4, 1, -1)
        unsure[marked > 0] = 0
        return tips, unsure


def features_of(graph):
    """Names of `FEATURES` in a graph: behind the 8 bits where there are any, so that the convolutions before stay merged with them."""
    produced = {name for node in graph.node for name in node.output}
    in_8_bits = [name + "_DequantizeLinear_Output" for name in FEATURES]
    return [rounded if rounded in produced else name for name, rounded in zip(FEATURES, in_8_bits)]


class Reader:
    """An exported detector that also gives the features from which tips are computed."""

    def __init__(self, path, threads):
        model = without_tips(path)
        self.names = features_of(model.graph)
        model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in self.names)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = threads, 3
        self.session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])

    def __call__(self, picture):
        """Features of stride 8 (C x rows x columns) and of stride 16 of a picture of the network's size."""
        found = self.session.run(self.names, {"images": picture.astype(np.float32).transpose(2, 0, 1)[None]})
        return np.concatenate([v[0] for v in found[:-1]]), found[-1][0]


def without_tips(path):
    """The model at `path`, as it was before `insert`."""
    model = onnx.load(str(path))
    graph = model.graph
    is_ours = lambda name: name.lstrip("/").startswith("tips")
    for values in (graph.node, graph.initializer, graph.output):
        kept = [v for v in values if not is_ours(v.name) and not any(is_ours(o) for o in getattr(v, "output", []))]
        del values[:]
        values.extend(kept)
    # What only the map has read, such as its features in 8 bits.
    while True:
        read = {name for node in graph.node for name in node.input} | {o.name for o in graph.output}
        kept = [node for node in graph.node if read & set(node.output)]
        if len(kept) == len(graph.node):
            break
        del graph.node[:]
        graph.node.extend(kept)
    kept = [value for value in graph.initializer if value.name in read]
    del graph.initializer[:]
    graph.initializer.extend(kept)
    return model


def insert(graph, weights):
    """Puts the output `tips` into a graph: 1 x 3 x rows x columns, the score of a tip near a cell, and its column and row in px of the input."""
    read = features_of(graph)

    def stored(key, value):
        graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value, np.float32), f"tips.{key}"))
        return f"tips.{key}"

    def node(kind, inputs, output, **options):
        graph.node.append(helper.make_node(kind, inputs, [output], f"/tips/{output.removeprefix('tips_')}/{kind}", **options))
        return output

    def conv(key, source, output, rows=slice(None), scale=1.0, **options):
        values = [stored(f"{output}.{part}", scale * weights[f"{key}.{part}"][rows]) for part in ("weight", "bias")]
        return node("Conv", [source, *values], output, **options)

    fine = conv("fine", node("Concat", read[:-1], "tips_features", axis=1), "tips_fine")
    scales = stored("scales", np.array([1, 1, 2, 2]))
    coarse = conv("coarse", read[-1], "tips_coarse16")
    nearest = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
    x = node("Relu", [node("Add", [fine, node("Resize", [coarse, "", scales], "tips_coarse", **nearest)], "tips_sum")], "tips_0")
    for k in (1, 2, 3):
        bent = node("Relu", [conv(f"wide{k}", x, f"tips_wide{k}", pads=[k] * 4, dilations=[k, k])], f"tips_bent{k}")
        x = node("Add", [x, bent], f"tips_{k}")
    score = node("Sigmoid", [conv("out", x, "tips_logit", rows=[0])], "tips_score")
    row, column = np.mgrid[: INPUT[1] // CELL, : INPUT[0] // CELL]
    middles = stored("cells", CELL * (np.stack((column, row))[None] + 0.5))
    position = node("Add", [conv("out", x, "tips_offset", rows=[1, 2], scale=CELL), middles], "tips_position")
    node("Concat", [score, position], OUTPUT, axis=1)
    graph.output.append(helper.make_tensor_value_info(OUTPUT, onnx.TensorProto.FLOAT, [1, 3, INPUT[1] // CELL, INPUT[0] // CELL]))


def quantise(path, pictures):
    """Stores the map of tips of the file at `path` in 8 bits; its ranges come from `pictures` of the network's size. All but the last layer."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    class Pictures(CalibrationDataReader):
        def __init__(self):
            self.left = iter(pictures)

        def get_next(self):
            picture = next(self.left, None)
            return None if picture is None else {"images": picture.astype(np.float32).transpose(2, 0, 1)[None]}

    model = onnx.load(str(path))
    last = ("/tips/logit/", "/tips/score/", "/tips/offset/", "/tips/position/", "/tips/tips/")
    names = [n.name for n in model.graph.node if n.name.startswith("/tips/") and not n.name.startswith(last)]
    # 7 bits for weights: no sum of two products overflows 16 bits on processors without VNNI.
    options = {"quant_format": QuantFormat.QDQ, "per_channel": True, "reduce_range": True, "nodes_to_quantize": names}
    quantize_static(str(path), str(path), Pictures(), activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8, **options)
