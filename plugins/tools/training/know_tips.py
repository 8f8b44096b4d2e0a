#!/usr/bin/env python3
"""Teaches an exported detector where instruments end, without training or exporting it again.

    python3 make_phantom_frames.py --panoscope target/debug/panoscope --out phantom --scenes 192 --frames 12 --seed 31
    python3 make_empty_frames.py --out empty --data FRAMES --without v08,v09,v10
    python3 know_tips.py --model instruments.onnx --data FRAMES --phantom phantom --empty empty/crops empty/cavities --out instruments_new.onnx

Puts the output `tips` into the file: for each cell of 8 px the score of a tip near it, and where it is. It is computed from features that the network
makes anyway, by a few small layers. They learn from rendered frames, from rendered instruments set into pictures without any, and from real frames whose
tips tips.toml lists. Weights, boxes and metadata stay as they are; tips that the file has already are replaced. Where the file is in 8 bits, so are these
layers. Needs PyTorch, onnx, onnxruntime, NumPy and OpenCV, and some 5 GB in --work.
"""

import argparse
import shutil
import tempfile
import tomllib
from pathlib import Path

LISTS = Path(__file__).parent / "tips.toml"


def tips_of(path, kinds):
    """Positions of tips by frame, as shares of width and height, from the lists `kinds` of a file."""
    found = {}
    for kind in kinds:
        for name, x, y in tomllib.loads(Path(path).read_text())[kind]:
            if not (0 <= x <= 1 and 0 <= y <= 1):
                raise SystemExit(f"{path}: {kind}: {name}: {x}, {y} are no shares of width and height")
            found.setdefault(name, []).append((x, y))
    return found


def store(reader, samples, count, folder, report):
    """Features and marks of `count` samples, on disk."""
    import numpy as np

    arrays, tips, unsure = None, [], []
    for number in range(count):
        picture, *marks = samples.sample(number)
        values = reader(picture)
        if arrays is None:
            open_new = lambda name, v: np.lib.format.open_memmap(folder / f"{name}.npy", "w+", np.float16, (count, *v.shape))
            arrays = [open_new(name, v) for name, v in zip(("fine", "coarse"), values)]
        for array, value in zip(arrays, values):
            array[number] = value
        tips.append(marks[0])
        unsure.append(marks[1])
        if number % 1000 == 0:
            report(f"samples: {number} of {count}")
    return (*arrays, np.array(tips), np.array(unsure))


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--model", required=True, type=Path)
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--data", required=True, type=Path, help="real frames with boxes (VOC, COCO, YOLO)")
    p.add_argument("--split", default="train")
    p.add_argument("--tips", type=Path, default=LISTS, help="lists of tips in real frames (default: %(default)s)")
    p.add_argument("--phantom", required=True, type=Path, help="folder of make_phantom_frames.py")
    p.add_argument("--empty", required=True, type=Path, nargs="+", help="folders of pictures without instruments")
    p.add_argument("--work", type=Path, help="folder for features, deleted at the end (default: a temporary one)")
    p.add_argument("--samples", type=int, default=7500)
    p.add_argument("--steps", type=int, default=3000)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    for path in (a.model, a.data, a.tips, a.phantom, *a.empty):
        if not path.exists():
            p.error(f"there is no {path}")
    if a.out.exists():
        p.error(f"--out: {a.out} exists and is not overwritten")
    try:
        import cv2
        import torch

        from instruments import tips
        from instruments.data import read
        from instruments.onnx_store import write_model
        from instruments.tip_learning import Windows, learn
    except ModuleNotFoundError as missing:
        raise SystemExit(f"this needs {missing.name}: see README.md, Environment") from None
    cv2.setNumThreads(1)
    torch.set_num_threads(a.threads)
    report = lambda text: print(text, flush=True)
    rendered = tips.read_rendered(a.phantom)
    real = tips.read_real(read(a.data, a.split), tips_of(a.tips, ("agreed", "hand")))
    empty = [path for folder in a.empty for path in sorted(folder.iterdir()) if path.suffix in (".png", ".jpg")]
    report(f"{len(rendered)} rendered and {len(real)} real frames, {len(empty)} without instruments")
    samples = tips.Samples(rendered, real, empty, a.seed)
    work = Path(tempfile.mkdtemp(dir=a.work))
    try:
        fine, coarse, marked, unsure = store(tips.Reader(a.model, a.threads), samples, a.samples, work, report)
        weights = learn(Windows(fine, coarse, marked, unsure, a.seed), a.steps, a.seed, lambda step, loss: report(f"step {step}: {loss:.2f}"))
    finally:
        shutil.rmtree(work)
    model = tips.without_tips(a.model)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    is_quantised = any(node.op_type == "QuantizeLinear" for node in model.graph.node)
    tips.insert(model.graph, weights)
    write_model(model, a.out, metadata)
    if is_quantised:
        tips.quantise(a.out, [samples.sample(a.samples + number)[0] for number in range(200)])
        write_model(tips.onnx.load(str(a.out)), a.out, metadata)


if __name__ == "__main__":
    main()
