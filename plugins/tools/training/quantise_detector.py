#!/usr/bin/env python3
"""Writes an exported detector with 8-bit weights and activations: about half the time of 32 bits on a CPU, a quarter of the file.

    python3 quantise_detector.py --model instruments32.onnx --frames FOLDER --out instruments.onnx [--data FOLDER --split val]

Ranges of the activations are those seen in frames of --frames (VOC, COCO or YOLO data; the frames that it learned from). Weights are quantised for each
channel of a convolution (Nagel et al. 2021, "A White Paper on Neural Network Quantization"), so that no processor overflows. The last convolutions, which give boxes and scores, stay in 32 bits. Metadata is kept; statistics
of pictures (--learned-from of export_detector.py) are written anew, from the features of the new file. With --data it is scored beside the old one.
Needs PyTorch, onnx and onnxruntime.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from export_detector import score
from instruments.data import read
from instruments.familiar import Session, learned_from, placed
from instruments.onnx_store import write
from instruments.pictures import metadata_of

# Largest sum of two neighbouring weights: times 255 it fits in 16 bits with sign.
PAIR = 128
# Frames that show the ranges of the activations.
FRAMES = 240


def last_nodes(graph):
    """Names of the convolutions after which no other follows, and of all nodes behind them."""
    readers = {}
    for node in graph.node:
        for name in node.input:
            readers.setdefault(name, []).append(node)

    def behind(node):
        found, waiting = {}, [r for name in node.output for r in readers.get(name, [])]
        while waiting:
            one = waiting.pop()
            if one.name not in found:
                found[one.name] = one
                waiting += [r for name in one.output for r in readers.get(name, [])]
        return found

    names = set()
    for node in graph.node:
        if node.op_type == "Conv":
            after = behind(node)
            if not any(n.op_type == "Conv" for n in after.values()):
                names |= {node.name, *after}
    return sorted(names)


def weight_scales(graph):
    """Scales for the weights of convolutions that are no depthwise ones, channel by channel.

    Processors without VNNI add the products of two neighbouring input channels in 16 bits, where two large weights times 255 would overflow. With
        Products of depthwise convolutions are added in 32 bits everywhere."""
    from onnxruntime.quantization import QuantType

    stored = {tensor.name: tensor for tensor in graph.initializer}
    settings = {}
    for node in graph.node:
        if node.op_type != "Conv" or node.input[1] not in stored or any(a.name == "group" and a.i > 1 for a in node.attribute):
            continue
        weight = numpy_helper.to_array(stored[node.input[1]])
        row = weight.transpose(0, 2, 3, 1).reshape(len(weight), -1)
        pairs = np.pad(row, ((0, 0), (0, row.shape[1] % 2))).reshape(len(row), -1, 2)
        sums = np.maximum(np.maximum(pairs, 0).sum(2), np.maximum(-pairs, 0).sum(2)).max(1)
        # Rounding may add a half to each of the two.
        scales = np.maximum(np.maximum(np.abs(row).max(1) / 127, sums / (PAIR - 1)), 1e-12).astype(np.float32)
        settings[node.input[1]] = [{"quant_type": QuantType.QInt8, "axis": 0, "scale": scale, "zero_point": np.int8(0)} for scale in scales]
    return settings


def size_of(graph):
    """Height and width of the network's input."""
    height, width = (d.dim_value for d in graph.input[0].type.tensor_type.shape.dim[2:])
    if not (height and width):
        raise SystemExit("the file has no fixed size of its input; export it with export_detector.py")
    return height, width


def quantise(source, out, pictures, method):
    """Writes the quantised file; `pictures` are inputs of the network (1 x 3 x H x W) that show what activations occur."""
    from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Reader(CalibrationDataReader):
        def __init__(self):
            self.left = iter(pictures)

        def get_next(self):
            x = next(self.left, None)
            return None if x is None else {"images": x}

    held = {p.key: p.value for p in onnx.load(str(source)).metadata_props}
    with tempfile.TemporaryDirectory() as folder:
        # Margins move into the convolutions, which quantised nodes between them would prevent later.
        plain = Path(folder) / "plain.onnx"
        quant_pre_process(str(source), str(plain), skip_symbolic_shape=True)
        model = onnx.load(str(plain))
    for i, node in enumerate(model.graph.node):
        node.name = node.name or f"node{i}"
    quantize_static(
        model,
        str(out),
        Reader(),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        extra_options={"TensorQuantOverrides": weight_scales(model.graph)},
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        nodes_to_exclude=last_nodes(model.graph),
        calibrate_method=getattr(CalibrationMethod, method),
    )
    write(out, held)


def time_of(paths, x, threads, rounds=60):
    """Median time of one picture in each file, ms; the files take turns, so that other work on the machine meets all alike."""
    sessions = [Session(path, threads) for path in paths]
    times = [[] for _ in paths]
    for _ in range(rounds):
        for session, taken in zip(sessions, times):
            begun = time.perf_counter()
            session(x)
            taken.append(1e3 * (time.perf_counter() - begun))
    return [float(np.median(t)) for t in times]


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--model", required=True, type=Path, help="file of export_detector.py, in 32 bits")
    p.add_argument("--frames", required=True, type=Path, help="frames that it learned from")
    p.add_argument("--frames-split", default="trainval")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--method", default="MinMax", choices=("MinMax", "Entropy", "Percentile"), help="how ranges follow from what is seen (default: %(default)s)")
    p.add_argument("--learned-from", type=Path, nargs="+", metavar="FOLDER", help="write statistics of these pictures anew; a folder of each kind")
    p.add_argument("--most-pictures", type=int, default=1500)
    p.add_argument("--data", type=Path, help="frames with boxes to score both files on")
    p.add_argument("--split", default="val")
    p.add_argument("--only", default="", help="score on these operations only: v02,v08")
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    if a.model.resolve() == a.out.resolve():
        p.error("--out would overwrite --model: name another file")
    import cv2

    height, width = size_of(onnx.load(str(a.model), load_external_data=False).graph)
    frames = read(a.frames, a.frames_split)
    frames = frames[:: max(1, len(frames) // FRAMES)]
    pictures = (placed(cv2.imread(str(f.path)), width, height)[0] for f in frames)
    quantise(a.model, a.out, pictures, a.method)
    if a.learned_from:
        kinds = [learned_from(a.out, folder, width, height, a.threads, a.most_pictures) for folder in a.learned_from]
        held = {p.key: p.value for p in onnx.load(str(a.out)).metadata_props}
        write(a.out, held | metadata_of(kinds))
    x = placed(cv2.imread(str(frames[0].path)), width, height)[0]
    before, after = time_of((a.model, a.out), x, a.threads)
    print(f"{a.out}: {a.out.stat().st_size / 1e6:.2f} MB; {a.threads} threads: {after:.2f} ms, {before:.2f} ms before")
    if a.data:
        only = set(filter(None, a.only.split(",")))
        for path in (a.model, a.out):
            score(path, a.data, a.split, only, width, height, a.threads)


if __name__ == "__main__":
    main()
