"""What is no instrument: a small second opinion on each box of an exported network, from the features that the box was made of."""

from dataclasses import dataclass

import cv2
import numpy as np
import onnx
import onnxruntime
from onnx import helper, numpy_helper

#: Share of a box that instruments cover, below which it holds none, and from which it holds one.
NONE_BELOW, SOME_FROM = 0.02, 0.15
#: Probability of an instrument from which a box says something.
LEAST = 0.03
#: Values between the features and the opinion.
INNER = 32
STRIDES = (8, 16, 32)


@dataclass
class Tap:
    """Where a network decides: `features` (read here), and the `logits` of which `column` is lowered, or raised where `raises`."""

    features: list
    logits: str
    column: int
    columns: int
    raises: bool
    is_map: bool


def taps_of(graph):
    """The taps of a detector of the YOLOX family, one for each stride, or of a torchvision segmenter."""
    of_name = {node.name: node for node in graph.node}
    heads = [of_name.get(f"/object_heads.{level}/Conv") for level in range(len(STRIDES))]
    if all(heads):
        classes = [of_name[f"/class_heads.{level}/Conv"] for level in range(len(STRIDES))]
        return [Tap([c.input[0], o.input[0]], o.output[0], 0, 1, False, True) for c, o in zip(classes, heads)]
    scores = [node for node in graph.node if node.op_type == "Gemm" and node.name.endswith("cls_score/Gemm")]
    seconds = [node for node in graph.node if node.op_type == "Gemm" and node.name.endswith("fc7/Gemm")]
    if len(scores) != 1 or len(seconds) != 1:
        raise SystemExit("neither a detector of the YOLOX family nor a segmenter of export_masks.py")
    columns = next(t.dims[0] for t in graph.initializer if t.name.removesuffix("_half") == scores[0].input[2])
    return [Tap([seconds[0].input[0], scores[0].input[0]], scores[0].output[0], 0, columns, True, False)]


def without_opinion(path):
    """The model at `path`, as it was before `insert`."""
    model = onnx.load(str(path))
    graph = model.graph
    is_ours = lambda name: name.lstrip("/").startswith("empty")
    lowered = {n.output[0]: n.input[0] for n in graph.node if is_ours(n.name) and n.output[0].endswith("_logits")}
    for node in graph.node:
        node.input[:] = [lowered.get(name, name) for name in node.input]
    for values in (graph.node, graph.initializer):
        kept = [value for value in values if not is_ours(value.name)]
        del values[:]
        values.extend(kept)
    return model


def proposals_of(graph):
    """Name of a segmenter's proposals, N x 4."""
    return next(node.input[0] for node in graph.node if node.name.endswith("box_roi_pool/Concat"))


class Reader:
    """An exported network, without second opinion, that also gives what its taps read, for each box that it half believes."""

    def __init__(self, path, threads):
        model = without_opinion(path)
        self.taps = taps_of(model.graph)
        self.is_detector = self.taps[0].is_map
        self.size = [d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim][:1:-1]
        names = [name for tap in self.taps for name in (*tap.features, tap.logits)]
        names.append("output" if self.is_detector else proposals_of(model.graph))
        known = {o.name for o in model.graph.output}
        model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in names if name not in known)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = threads, 3
        self.session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
        self.names = names

    def __call__(self, picture):
        """Of a picture of the network's size: per tap features (N x 2C: of the box, and their mean over all boxes), logits (N x columns) and boxes (N x 4, corners, px)."""
        x = picture.astype(np.float32).transpose(2, 0, 1)[None]
        x = x if self.is_detector else np.ascontiguousarray(x[:, ::-1]) / np.float32(255)
        *values, last = self.session.run(self.names, {"images": x})
        found = []
        begin = 0
        for tap, stride, (a, b, logits) in zip(self.taps, STRIDES, zip(*[iter(values)] * 3)):
            if tap.is_map:
                features = np.concatenate((a, b), 1)[0]
                rows, columns = features.shape[1:]
                features, logits = features.reshape(len(features), -1).T, logits.reshape(1, -1).T
                y, x = np.mgrid[:rows, :columns].reshape(2, -1)
                out = last[0][begin : begin + rows * columns]
                begin += rows * columns
                middle = (out[:, :2] + np.stack((x, y), 1)) * stride
                half = np.exp(out[:, 2:4]) * stride / 2
                boxes = np.concatenate((middle - half, middle + half), 1)
                chance = 1 / (1 + np.exp(-logits[:, 0]))
            else:
                features, boxes = np.concatenate((a, b), 1), last
                e = np.exp(logits - logits.max(1, keepdims=True))
                chance = 1 - e[:, 0] / e.sum(1)
            kept = chance > LEAST
            around = np.broadcast_to(features.mean(0), features.shape)
            found.append((np.concatenate((features, around), 1)[kept], logits[kept], boxes[kept]))
        return found


def covered(ids, boxes):
    """Share of each box that instruments or doubt cover (`ids` above 0)."""
    h, w = ids.shape
    sums = cv2.integral((ids > 0).astype(np.uint8))
    b = np.round(boxes).astype(int)
    x0, x1, y0, y1 = (np.clip(b[:, k], 0, most) for k, most in ((0, w), (2, w), (1, h), (3, h)))
    area = np.maximum((x1 - x0) * (y1 - y0), 1)
    return (sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]) / area


def insert(graph, tap, number, weights):
    """Puts a second opinion into a graph: softplus of two layers on the features, taken from the objectness or added to the background."""
    (w1, b1), (w2, b2) = weights
    name = f"empty{number}"

    def stored(key, value):
        graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value, np.float32), f"{name}.{key}"))
        return f"{name}.{key}"

    kind = "Conv" if tap.is_map else "Gemm"
    shape = (lambda w: w[:, :, None, None]) if tap.is_map else (lambda w: w.T)
    own, around = np.split(w1, 2, axis=1)
    mean, axes = ("GlobalAveragePool", {}) if tap.is_map else ("ReduceMean", {"axes": [0], "keepdims": 1})
    nodes = [
        helper.make_node("Concat", tap.features, [f"{name}_features"], f"/{name}/Concat", axis=1),
        helper.make_node(mean, [f"{name}_features"], [f"{name}_mean"], f"/{name}/Mean", **axes),
        helper.make_node(kind, [f"{name}_features", stored("own", shape(own)), stored("b1", b1)], [f"{name}_own"], f"/{name}/Own"),
        helper.make_node(kind, [f"{name}_mean", stored("around", shape(around)), stored("b0", 0 * b1)], [f"{name}_around"], f"/{name}/Around"),
        helper.make_node("Add", [f"{name}_own", f"{name}_around"], [f"{name}_inner"], f"/{name}/Inner"),
        helper.make_node("Relu", [f"{name}_inner"], [f"{name}_bent"], f"/{name}/Relu"),
        helper.make_node(kind, [f"{name}_bent", stored("w2", shape(w2)), stored("b2", b2)], [f"{name}_sum"], f"/{name}/Second"),
        helper.make_node("Softplus", [f"{name}_sum"], [f"{name}_doubt"], f"/{name}/Softplus"),
    ]
    result = f"{name}_logits"
    if tap.raises:
        one = np.zeros((1, tap.columns), np.float32)
        one[0, tap.column] = 1
        nodes.append(helper.make_node("MatMul", [f"{name}_doubt", stored("column", one)], [f"{name}_column"], f"/{name}/Column"))
        nodes.append(helper.make_node("Add", [tap.logits, f"{name}_column"], [result], f"/{name}/Add"))
    else:
        nodes.append(helper.make_node("Sub", [tap.logits, f"{name}_doubt"], [result], f"/{name}/Sub"))
    for node in graph.node:
        for k, read in enumerate(node.input):
            if read == tap.logits:
                node.input[k] = result
    # After the last producer of what the new nodes read.
    needed = {*tap.features, tap.logits}
    place = max(i for i, node in enumerate(graph.node) if needed & set(node.output)) + 1
    all_nodes = list(graph.node)
    del graph.node[:]
    graph.node.extend(all_nodes[:place] + nodes + all_nodes[place:])
