#!/usr/bin/env python3
"""Teaches an exported detector or segmenter what is no instrument, without training or exporting it again.

    python3 make_empty_frames.py --data FRAMES --out empty
    python3 know_empty.py --model instruments.onnx --data FRAMES --phantom PHANTOM --empty empty/* --out instruments_new.onnx

Puts a second opinion into the file: two small layers on the features that the network makes of each box, whose answer only lowers the score of an
instrument. They learn from pictures without instruments (--empty; each folder counts alike), from the same with instruments of the frames set into them along
their outlines, and from frames as they are, where scores are to stay. Weights, boxes, outlines and metadata stay as they are; an opinion that the file has already is replaced. Seeds are fixed: the same data and
arguments give the same file. Needs PyTorch, onnx, onnxruntime, NumPy and OpenCV.
"""

import argparse
from pathlib import Path


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--model", required=True, type=Path)
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--empty", required=True, type=Path, nargs="+", help="folders of pictures without instruments; each counts alike")
    p.add_argument("--data", required=True, type=Path, help="real frames with boxes (VOC, COCO, YOLO)")
    p.add_argument("--split", default="train")
    p.add_argument("--without", default="", help="operations that nothing is learned from, separated by commas")
    p.add_argument("--phantom", type=Path, nargs="*", default=[], help="folders of make_phantom_frames.py")
    p.add_argument("--store", type=Path, default=Path("outlines"), help="folder that keeps guessed outlines (default: %(default)s)")
    p.add_argument("--samples", type=int, default=6000)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    for path in (a.model, a.data, *a.empty, *a.phantom):
        if not path.exists():
            p.error(f"there is no {path}")
    if a.out.exists():
        p.error(f"--out: {a.out} exists and is not overwritten")
    return a


def main():
    a = arguments()
    try:
        import cv2
        import torch

        from instruments import empty, opinion
        from instruments.data import group_of
        from instruments.onnx_store import write_model
        from instruments.outlines import read_coco, read_real
    except ModuleNotFoundError as missing:
        raise SystemExit(f"this needs {missing.name}: see README.md, Environment") from None
    cv2.setNumThreads(1)
    torch.set_num_threads(a.threads)
    reader = empty.Reader(a.model, a.threads)
    width, height = reader.size
    left_out = set(filter(None, a.without.split(",")))
    real = [f for f in read_real(a.data, a.split, width, height, a.store) if group_of(f.name) not in left_out]
    phantom = [f for folder in a.phantom for f in read_coco(folder, "train", width, height)]
    groups = [opinion.empties(sorted(folder.iterdir()), width, height) for folder in a.empty]
    print(f"{len(real)} real and {len(phantom)} rendered frames, empty: {', '.join(str(len(g)) for g in groups)}", flush=True)
    scenes = opinion.Scenes(phantom, real, groups, width, height, a.seed)
    model = empty.without_opinion(a.model)
    rows = opinion.rows_of(reader, scenes, range(a.samples))
    for number, (tap, (features, logits, is_some)) in enumerate(zip(reader.taps, rows)):
        weights = opinion.learn((features, logits, is_some), seed=a.seed)
        empty.insert(model.graph, tap, number, weights)
        lowered = logits - opinion.doubt_of(features, weights)
        shares = [((values[chosen] > 0).mean() if chosen.any() else 0.0) for chosen in (is_some, ~is_some) for values in (logits, lowered)]
        print(
            f"{' and '.join(tap.features[-1:])}: {is_some.sum()} boxes with, {(~is_some).sum()} without instrument; above an even chance "
            f"{100 * shares[0]:.1f} -> {100 * shares[1]:.1f} %, {100 * shares[2]:.1f} -> {100 * shares[3]:.1f} %",
            flush=True,
        )
    write_model(model, a.out, {entry.key: entry.value for entry in model.metadata_props})


if __name__ == "__main__":
    main()
