#!/usr/bin/env python3
"""Trains the instrument detector (YOLOX-nano) on frames with boxes and writes checkpoints from which it goes on.

    python3 train_detector.py --data FOLDER --out run [--start FILE] [--without v02,v08] [--also frames]

FOLDER holds VOC (ImageSets, Annotations, JPEGImages), COCO (train.json) or YOLO (images/train, labels/train) data. Frames of --also, as those
of make_phantom_frames.py, make a fixed share of the samples. Seeds are fixed: the same data, arguments and PyTorch give the same weights.
Training starts from the detector that ships, unless --start names other weights: an ONNX file of export_detector.py or of YOLOX-nano, a checkpoint of
this script, or `none` for random ones. The detector that ships has seen most frames of m2cai16-tool-locations: a score on those says little then.
Needs PyTorch, NumPy, OpenCV and, to start from ONNX, onnx: pip install torch numpy opencv-python-headless onnx
"""

import argparse
import copy
import math
import time
from pathlib import Path

SHIPPED = Path(__file__).resolve().parent.parent / "models" / "instruments.onnx"


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, type=Path)
    p.add_argument("--split", default="trainval", help="which split to learn from")
    p.add_argument("--test-split", default="test")
    p.add_argument("--also", type=Path, help="more frames to learn from (split `train`), as those of make_phantom_frames.py")
    p.add_argument("--also-share", type=float, default=0.12, help="share of the samples that come from --also")
    p.add_argument("--without", default="", help="operations kept out of training and tested on instead: v02,v08")
    p.add_argument("--start", type=Path, default=SHIPPED, help="weights to start from, or none: an ONNX file or a checkpoint (default: %(default)s)")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--epochs", type=int, default=40)
    p.add_argument("--plain-epochs", type=int, default=6, help="last epochs on whole, hardly changed frames")
    p.add_argument("--batch", type=int, default=16)
    p.add_argument("--rate", type=float, default=1e-3)
    p.add_argument("--width", type=int, default=416)
    p.add_argument("--height", type=int, default=256)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--test-every", type=int, default=5)
    a = p.parse_args()
    # Said before anything large is loaded.
    a.start = None if str(a.start) == "none" else a.start
    for option, path in (("--data", a.data), ("--start", a.start), ("--also", a.also)):
        if path and not path.exists():
            p.error(f"{option}: there is no {path}")
    return a


def main():
    a = arguments()
    try:
        import cv2
        import numpy as np
        import torch

        from instruments.assign import loss
        from instruments.augment import Augmented
        from instruments.batches import batches, blend, store
        from instruments.data import CLASSES, read
        from instruments.score import average_precision, detect
        from instruments.yolox import Yolox, load_onnx
    except ModuleNotFoundError as missing:
        raise SystemExit(f"training needs {missing.name}: pip install torch numpy opencv-python-headless onnx") from None

    torch.manual_seed(a.seed)
    torch.set_num_threads(a.threads)
    cv2.setNumThreads(1)
    a.out.mkdir(parents=True, exist_ok=True)
    left_out = set(filter(None, a.without.split(",")))
    everything = read(a.data, a.split)
    train = [f.load(a.width * 5 // 4) for f in everything if f.group not in left_out]
    if left_out:
        test = [f for split in (a.split, a.test_split) for f in read(a.data, split) if f.group in left_out]
    else:
        test = read(a.data, a.test_split)
    test = [f.load(a.width * 5 // 4) for f in test]
    print(f"{len(train)} frames to learn from, {len(test)} to test on", flush=True)

    # Channels last: depthwise convolutions take half the time on a CPU.
    model = Yolox(len(CLASSES)).to(memory_format=torch.channels_last)
    state_file = a.out / "state.pt"
    if a.start and a.start.suffix == ".onnx":
        load_onnx(model, a.start)
    elif a.start:
        model.load_state_dict(torch.load(a.start))
    average = copy.deepcopy(model).eval()
    decayed = [p for n, p in model.named_parameters() if p.ndim > 1]
    others = [p for n, p in model.named_parameters() if p.ndim <= 1]
    optimiser = torch.optim.AdamW([{"params": decayed, "weight_decay": 5e-4}, {"params": others, "weight_decay": 0.0}], lr=a.rate)
    epoch, step = 0, 0
    if state_file.exists():
        state = torch.load(state_file)
        model.load_state_dict(state["model"])
        average.load_state_dict(state["average"])
        optimiser.load_state_dict(state["optimiser"])
        epoch, step = state["epoch"], state["step"]
        print(f"goes on after epoch {epoch}", flush=True)
    more = [f.load(a.width * 5 // 4) for f in read(a.also, "train")] if a.also else []
    samples = Augmented(train + more, a.width, a.height, a.seed, guests=len(more), guests_share=a.also_share)
    per_epoch = len(train) // a.batch
    total = a.epochs * per_epoch
    while epoch < a.epochs:
        model.train()
        plain = epoch >= a.epochs - a.plain_epochs
        begun, sum_loss = time.time(), 0.0
        for x, truths in batches(samples, step * a.batch, per_epoch, a.batch, plain):
            rate = a.rate * min(1.0, (step + 1) / 200) * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * step / total)))
            for group in optimiser.param_groups:
                group["lr"] = rate
            value = loss(model(x), truths, l1=plain)
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
            optimiser.step()
            step += 1
            sum_loss += float(value)
            keep = min(0.9995, (1 + step) / (20 + step))
            blend(average, model, keep)
        epoch += 1
        line = f"epoch {epoch:3d}  loss {sum_loss / per_epoch:.3f}  {per_epoch * a.batch / (time.time() - begun):.1f} frames/s"
        if epoch % a.test_every == 0 or epoch == a.epochs:
            ap = average_precision(test, detect(average, test, a.width, a.height), len(CLASSES))
            line += f"  mAP50 {np.nanmean(ap):.4f}  " + " ".join(f"{n}={v:.3f}" for n, v in zip(CLASSES, ap))
        print(line, flush=True)
        kept = {"model": model.state_dict(), "average": average.state_dict(), "optimiser": optimiser.state_dict(), "epoch": epoch, "step": step}
        store(state_file, kept)
    torch.save(average.state_dict(), a.out / "weights.pt")


if __name__ == "__main__":
    main()
