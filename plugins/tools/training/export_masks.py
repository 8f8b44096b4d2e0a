#!/usr/bin/env python3
"""Writes a trained segmenter (`weights.pt` of train_masks.py) as the ONNX file that the `mask_rcnn` node reads.

    python3 export_masks.py --weights run/weights.pt --out instrument_masks.onnx [--half] [--picture FRAME.jpg]

The file takes one picture as torchvision's models do (1 x 3 x H x W, red first, 0..1, upper left, gray 114 beside it) and answers boxes N x 4,
labels N (from 1), scores N and masks N x 1 x 40 x 40 inside their boxes. Needs PyTorch, torchvision and onnx; with onnxruntime it compares.
"""

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
import torch
from torch import nn

from instruments.data import CLASSES, letterbox
from instruments.mask_rcnn import MaskRcnn
from instruments.onnx_store import export, store_half, write, write_card

SOURCE = "phantom frames of this repository; m2cai16-tool-locations (Jin et al. 2018) with outlines guessed from boxes; backbone and neck of the detector `instruments` (EfficientNet-Lite0, Apache-2.0)"
LICENCE = "research use: the training frames state no licence; no medical device"


class Exported(nn.Module):
    """One picture in torchvision's form; four tensors out."""

    def __init__(self, model):
        super().__init__()
        model.pyramid.fold()
        self.model = model

    def forward(self, x):
        found = self.model(x)[0]
        return found["boxes"], found["labels"], found["scores"], found["masks"]


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--weights", type=Path, help="weights.pt or state.pt of train_masks.py; left out, random ones (to try the path)")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--half", action="store_true", help="store weights as 16-bit floats")
    p.add_argument("--min-score", type=float, default=0.05, help="lowest score answered")
    p.add_argument("--picture", type=Path, help="picture for the comparison; left out, noise")
    p.add_argument("--card", type=Path, help="write a model card here")
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    torch.manual_seed(1)
    torch.set_num_threads(a.threads)
    plain, folded = MaskRcnn(len(CLASSES)).eval(), MaskRcnn(len(CLASSES)).eval()
    state = torch.load(a.weights, map_location="cpu") if a.weights else plain.state_dict()
    state = state.get("average", state)
    for model in (plain, folded):
        model.load_state_dict(state)
        model.heads.score_thresh = a.min_score
    if a.picture is None:
        frame = np.random.default_rng(1).integers(0, 256, (a.height, a.width, 3)).astype(np.uint8)
    else:
        import cv2

        read = cv2.imread(str(a.picture))
        if read is None:
            raise SystemExit(f"{a.picture}: not a picture that can be read")
        frame = letterbox(read, np.zeros((0, 5), np.float32), a.width, a.height)[0]
    blue_first = torch.from_numpy(frame.transpose(2, 0, 1)[None].astype(np.float32))
    x = blue_first.flip(1) / 255.0
    names = ["boxes", "labels", "scores", "masks"]
    count = {0: "instances"}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore")
        export(Exported(folded).eval(), x, a.out, names, dynamic_axes={n: count for n in names})
    metadata = {
        "names": str(dict(enumerate(CLASSES))),
        "task": "segment",
        "family": "torchvision",
        "stride": "32",
        "imgsz": str([a.height, a.width]),
        "batch": "1",
        "description": "Mask R-CNN on EfficientNet-Lite0 with a PAN neck, surgical instruments",
        "source": SOURCE,
        "license": LICENCE,
    }
    write(a.out, metadata, store_half if a.half else None)
    if a.card:
        write_card(a.card, a.out.stem, metadata, [])
    print(f"{a.out}: {a.out.stat().st_size / 1e6:.2f} MB, {a.width}x{a.height}, {'16' if a.half else '32'}-bit weights")
    try:
        import onnxruntime
    except ModuleNotFoundError as e:
        print(f"not compared: {e}; `pip install onnxruntime` adds the comparison")
        return
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = a.threads, 3
    session = onnxruntime.InferenceSession(str(a.out), options, providers=["CPUExecutionProvider"])
    with torch.no_grad():
        want = plain(blue_first)[0]
    got = dict(zip(names, session.run(None, {"images": x.numpy()})))
    print(f"{len(got['scores'])} instances, PyTorch {len(want['scores'])}", end="")
    if len(got["scores"]) == len(want["scores"]) > 0:
        print(", largest differences: " + ", ".join(f"{n} {np.abs(got[n] - want[n].numpy()).max():.2g}" for n in names), end="")
    times = []
    for _ in range(50):
        begun = time.perf_counter()
        session.run(None, {"images": x.numpy()})
        times.append(time.perf_counter() - begun)
    print(f"\nnetwork alone, {a.threads} threads: median {1e3 * np.median(times):.1f} ms, least {1e3 * min(times):.1f} ms")


if __name__ == "__main__":
    main()
