#!/usr/bin/env python3
"""Trains the segmenter (Mask R-CNN on the detector's backbone) on phantom frames with exact outlines and on real frames with boxes.

    python3 make_phantom_frames.py --panoscope target/debug/panoscope --out frames
    python3 train_masks.py --phantom frames --data FOLDER --start detector/weights.pt --out run --minutes 25

Real frames have no outlines: what separates well from the tissue in and along a box gets one by guess, the rest is looked away from
(instruments/box_masks.py). Instruments of both worlds are set along their outlines into real and rendered frames. Goes on from its last
checkpoint; the checkpoint that does best on held-out scenes and frames becomes `weights.pt`. Seeds are fixed: the same data, arguments,
PyTorch and number of steps give the same weights. Needs PyTorch, torchvision, NumPy, OpenCV; onnx where --start is an ONNX file.
"""

import argparse
import copy
import math
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from instruments.batches import batches, blend, store
from instruments.data import CLASSES
from instruments.mask_rcnn import MaskRcnn, start_from
from instruments.mask_score import mask_ap50
from instruments.outlines import Mixed, read_coco, read_real
from instruments.training import Pause


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--phantom", type=Path, nargs="+", default=[], help="folders of make_phantom_frames.py")
    p.add_argument("--data", type=Path, help="real frames with boxes (VOC, COCO, YOLO) or with outlines (VIA)")
    p.add_argument("--split", default="train")
    p.add_argument("--val-split", default="val")
    p.add_argument("--start", type=Path, help="a trained lite0 detector (weights.pt), for backbone and neck")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--steps", type=int, default=3000, help="learning steps altogether")
    p.add_argument("--minutes", type=float, default=0, help="ends early after so long in this call, with the rate brought down in time; 0 never")
    p.add_argument("--epoch", type=int, default=150, help="steps between checkpoints")
    p.add_argument("--test-every", type=int, default=3, help="epochs between tests")
    p.add_argument("--plain-share", type=float, default=0.15, help="last part of the steps, on hardly changed frames")
    p.add_argument("--batch", type=int, default=6)
    p.add_argument("--rate", type=float, default=1e-3)
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--compile", action="store_true", help="compile backbone and neck first; needs a C++ compiler")
    p.add_argument("--workers", type=int, default=0, help="processes that make the samples; 0: a thread")
    p.add_argument("--bf16", action="store_true", help="compute backbone and neck in bfloat16")
    p.add_argument("--pause-while", type=Path, metavar="FILE", help="wait between batches while FILE exists")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    return p.parse_args()


def main():
    a = arguments()
    if a.width % 32 or a.height % 32:
        raise SystemExit("--width and --height are multiples of 32")
    torch.set_num_threads(a.threads)
    cv2.setNumThreads(1)
    torch.manual_seed(a.seed)
    a.out.mkdir(parents=True, exist_ok=True)
    phantom = [f for folder in a.phantom for f in read_coco(folder, "train", a.width, a.height)]
    phantom_val = [f for folder in a.phantom for f in read_coco(folder, "val", a.width, a.height)]
    real = read_real(a.data, a.split, a.width, a.height, a.out) if a.data else []
    real_val = read_real(a.data, a.val_split, a.width, a.height, a.out) if a.data else []
    if not (phantom or real):
        raise SystemExit("give --phantom or --data: there is nothing to learn from")
    phantom_val, real_val = phantom_val[::2], real_val[::4]
    print(f"{len(phantom)} phantom and {len(real)} real frames to learn from", flush=True)
    samples = Mixed(phantom, real, a.width, a.height, a.seed)

    model = MaskRcnn(len(CLASSES))
    if a.start:
        start_from(model, a.start)
        # It knows instruments well and takes most of a step's time.
        model.fix_backbone()
    average = copy.deepcopy(model).eval()
    model.bf16 = a.bf16
    if a.compile:
        model.pyramid.compile()
    features = [p for n, p in model.named_parameters() if n.startswith("pyramid.features.") and p.requires_grad]
    fresh = [p for n, p in model.named_parameters() if not n.startswith("pyramid.features.")]
    # The neck has learnt what instruments look like: it is only bent a little.
    shares = (0.2 if a.start else 1.0, 1.0)
    optimiser = torch.optim.AdamW([{"params": features}, {"params": fresh}], lr=a.rate, weight_decay=1e-4)
    state_file, step, best = a.out / "state.pt", 0, -1.0
    if state_file.exists():
        state = torch.load(state_file)
        model.load_state_dict(state["model"])
        average.load_state_dict(state["average"])
        optimiser.load_state_dict(state["optimiser"])
        step, best = state["step"], state["best"]
        print(f"goes on after step {step}", flush=True)
    begun, pause = time.time(), Pause(a.pause_while)
    while step < a.steps:
        model.train()
        # Sampling of proposals draws from PyTorch's generator: the same after a resumption.
        torch.manual_seed(a.seed * 1_000_003 + step)
        spent = (time.time() - begun) / (60 * a.minutes) if a.minutes else 0.0
        progress = max(step / a.steps, spent)
        plain = progress >= 1 - a.plain_share
        sums, epoch_begun = {}, time.time()
        count = min(a.epoch, a.steps - step)
        plan = [((step + i) * a.batch, plain) for i in range(count)]
        for x, targets in batches(samples, plan, a.batch, workers=a.workers):
            paused_s = pause.wait()
            begun, epoch_begun = begun + paused_s, epoch_begun + paused_s
            if a.minutes:
                progress = max(step / a.steps, (time.time() - begun) / (60 * a.minutes))
            else:
                progress = step / a.steps
            rate = a.rate * min(1.0, (step + 1) / 150) * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(1.0, progress))))
            for group, share in zip(optimiser.param_groups, shares):
                group["lr"] = rate * share
            losses = model(x, targets)
            value = sum(losses.values())
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 5.0)
            optimiser.step()
            step += 1
            for k, v in losses.items():
                sums[k] = sums.get(k, 0.0) + float(v) / count
            keep = min(0.998, (1 + step) / (20 + step))
            blend(average, model, keep)
        line = f"step {step:5d}  " + "  ".join(f"{k.removeprefix('loss_')} {v:.3f}" for k, v in sums.items())
        line += f"  {count * a.batch / (time.time() - epoch_begun):.1f} frames/s"
        over = step >= a.steps or (a.minutes and time.time() - begun > 60 * a.minutes)
        if over or (step // a.epoch) % a.test_every == 0:
            scores = [mask_ap50(average, frames, len(CLASSES)) for frames in (phantom_val, real_val) if frames]
            mean = float(np.mean([np.nanmean(s) for s in scores]))
            line += "  mask AP50 " + ", ".join(f"{np.nanmean(s):.3f}" for s in scores)
            if mean > best:
                best = mean
                torch.save(average.state_dict(), a.out / "weights.pt")
                line += "  (best)"
        print(line, flush=True)
        kept = {"model": model.state_dict(), "average": average.state_dict(), "optimiser": optimiser.state_dict(), "step": step, "best": best}
        store(state_file, kept)
        if over:
            break


if __name__ == "__main__":
    main()
