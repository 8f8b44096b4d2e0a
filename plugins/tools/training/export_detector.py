#!/usr/bin/env python3
"""Writes a trained detector (`weights.pt` of train_detector.py) as the ONNX file that the `yolo` node reads.

    python3 export_detector.py --weights run/weights.pt --out instruments.onnx [--half] [--data FOLDER] [--picture FRAME.jpg]
    python3 export_detector.py --weights run/weights.pt --out instruments.onnx --calibration calibration.json --learned-from FOLDER

The file answers one 1 x N x (5 + C) tensor: boxes relative to the grid, objectness and classes as probabilities. Decoding of the few boxes
above the score limit is left to the reader: the network computes no exponential for the thousands below it. Batch normalisation is folded into
the convolutions, and the slicing at its begin together with the first convolution becomes one convolution of 6 x 6 px, which gives the same
numbers; of the lite networks the shift and scale of the picture go into the first convolution. Needs PyTorch and onnx; with onnxruntime it also
compares the file's answers with PyTorch's, times it, and with --data scores it.
With --calibration, a file of `panoscope eval detect --folds RUNS --calibration FILE`, the `yolo` node reports probabilities and says `unknown` where a
class is not sure. With --learned-from, the folders of the frames that it learned from, it warns of pictures unlike them (needs onnxruntime).
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from instruments import onnx_store, pictures
from instruments.data import CLASSES, letterbox, normal_name, read
from instruments.familiar import Session, learned_from
from instruments.networks import DESCRIPTIONS, SOURCES, Exported, build
from instruments.onnx_store import store_half, write, write_card
from instruments.score import average_precision, rows_of

CALIBRATION = "panoscope-calibration-1"
DATA = "m2cai16-tool-locations (Jin et al. 2018)"
LICENCE = "research use: the training frames state no licence; no medical device"


def calibration_metadata(path, classes):
    """Curves of scores and objectness and the limits of the classes, from a file of `panoscope eval detect --folds`."""
    try:
        stored = json.loads(Path(path).read_text())
        if stored["format"] != CALIBRATION:
            raise SystemExit(f"{path}: its format is `{stored['format']}`; this script reads `{CALIBRATION}`")
        limits = dict(zip(map(normal_name, stored["classes"]), stored["limits"]))
        curves = {"calibration_score": stored["score"], "calibration_objectness": stored["objectness"]}
        metadata = {key: f"{curve['temperature']:.6g} {curve['bias']:.6g}" for key, curve in curves.items() if curve}
        metadata["class_limits"] = " ".join(f"{limits[name]:.4f}" for name in classes)
        metadata["class_limits_precision"] = f"{stored['precision']:g}"
    except (KeyError, TypeError, ValueError) as wrong:
        raise SystemExit(f"{path}: no calibration of these classes ({wrong}); `panoscope eval detect --folds RUNS --calibration {path}` writes one") from None
    return metadata


def export(model, kind, path, width, height, half, classes, calibration=None):
    x = torch.zeros(1, 3, height, width)
    onnx_store.export(model, x, path, ["output", pictures.OUTPUT])
    metadata = {
        "names": str(dict(enumerate(classes))),
        "task": "detect",
        "stride": "32",
        "imgsz": str([height, width]),
        "batch": "1",
        "family": "yolox",
        "description": DESCRIPTIONS[kind],
        "source": f"{DATA}, {SOURCES[kind]}",
        "license": LICENCE,
        **(calibration or {}),
    }
    write(path, metadata, store_half if half else None)
    return metadata


def compare(path, plain, width, height, picture, threads):
    """Largest difference to the model as it was trained, and the time of one run."""
    session = Session(path, threads)
    if picture is None:
        x = np.random.default_rng(1).integers(0, 256, (1, 3, height, width)).astype(np.float32)
    else:
        import cv2

        frame = cv2.imread(str(picture))
        if frame is None:
            raise SystemExit(f"{picture}: not a picture that can be read")
        x = letterbox(frame, np.zeros((0, 5), np.float32), width, height)[0].transpose(2, 0, 1)[None].astype(np.float32)
    with torch.no_grad():
        levels = [torch.cat((v[:, :4], v[:, 4:].sigmoid()), 1).flatten(2) for v in plain(torch.from_numpy(x))]
        want = torch.cat(levels, 2).permute(0, 2, 1).numpy()
    got = session(x)
    if got.shape != want.shape:
        raise SystemExit(f"{path} answers {got.shape}, PyTorch {want.shape}")
    boxes, scores = np.abs(got - want)[..., :4].max(), np.abs(got - want)[..., 4:].max()
    times = []
    for _ in range(200):
        begun = time.perf_counter()
        session(x)
        times.append(time.perf_counter() - begun)
    print(f"differs from PyTorch by {boxes:.2g} (boxes, cells) and {scores:.2g} (scores)")
    print(f"network alone, {threads} threads: median {1e3 * np.median(times):.2f} ms, least {1e3 * min(times):.2f} ms")


def score(path, data, split, only, width, height, threads):
    """mAP@0.5 of the file on the frames of `split` (and only of the operations `only`, where given)."""
    session = Session(path, threads)
    frames = [f for f in read(data, split) if not only or f.group in only]
    found = []
    for f in frames:
        f.load(width * 5 // 4)
        picture, _, scale = letterbox(f.picture, f.boxes, width, height)
        raw = session(picture.transpose(2, 0, 1)[None].astype(np.float32))[0]
        found.append(rows_of(raw, width, height, scale))
    ap = average_precision(frames, found, len(CLASSES))
    words = f"{len(frames)} frames of {f'{split}, {sorted(only)}' if only else split}: mAP50 {np.nanmean(ap):.4f}  "
    words += " ".join(f"{n}={v:.3f}" for n, v in zip(CLASSES, ap))
    print(words)
    return words


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--weights", type=Path, help="weights.pt or state.pt of train_detector.py; left out, random ones (to try the path)")
    p.add_argument("--network", default="lite0", choices=list(DESCRIPTIONS))
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--half", action="store_true", help="store weights as 16-bit floats: half the file, computed in 32 bits all the same")
    p.add_argument("--data", type=Path, help="frames with boxes to score the file on")
    p.add_argument("--split", default="test")
    p.add_argument("--only", default="", help="score on these operations only: v02,v08")
    p.add_argument("--picture", type=Path, help="picture for the comparison; left out, noise")
    p.add_argument("--card", type=Path, help="write a model card here")
    p.add_argument("--calibration", type=Path, metavar="FILE.json", help="calibration of `panoscope eval detect --folds`")
    p.add_argument("--learned-from", type=Path, nargs="+", metavar="FOLDER", help="frames it learned from, to warn of pictures unlike them; a folder of each kind")
    p.add_argument("--most-pictures", type=int, default=1500, help="most frames of --learned-from that are looked at (default: %(default)s)")
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    if a.width % 32 or a.height % 32:
        p.error("--width and --height are multiples of 32")
    calibration = calibration_metadata(a.calibration, CLASSES) if a.calibration else None
    torch.manual_seed(1)
    torch.set_num_threads(a.threads)
    plain = build(a.network, len(CLASSES)).eval()
    if a.weights:
        state = torch.load(a.weights, map_location="cpu", weights_only=True)
        plain.load_state_dict(state.get("average", state))
    with torch.no_grad():
        metadata = export(Exported(plain, features=True).eval(), a.network, a.out, a.width, a.height, a.half, CLASSES, calibration)
    if a.learned_from:
        try:
            kinds = [learned_from(a.out, folder, a.width, a.height, a.threads, a.most_pictures) for folder in a.learned_from]
            metadata |= pictures.metadata_of(kinds)
        except ModuleNotFoundError as missing:
            raise SystemExit(f"--learned-from needs {missing.name}: pip install onnxruntime") from None
        write(a.out, metadata)
    print(f"{a.out}: {a.out.stat().st_size / 1e6:.2f} MB, {a.width}x{a.height}, {'16' if a.half else '32'}-bit weights")
    measured = []
    try:
        compare(a.out, plain, a.width, a.height, a.picture, a.threads)
        if a.data:
            measured.append(score(a.out, a.data, a.split, set(filter(None, a.only.split(","))), a.width, a.height, a.threads))
    except ModuleNotFoundError as e:
        print(f"not compared: {e}; `pip install onnxruntime` adds the comparison")
    if a.card:
        write_card(a.card, a.out.stem, metadata, measured)


if __name__ == "__main__":
    main()
