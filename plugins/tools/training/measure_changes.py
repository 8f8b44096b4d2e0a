#!/usr/bin/env python3
"""What each change of the pictures costs a detector: mAP50 on the frames of a fold, each changed, beside that on the same frames as they are.

    python3 measure_changes.py --data FRAMES --fold 3 --weights runs/lite/fold3/weights.pt [--weights OTHER.pt] --width 384 --height 224

The changes are those of training (instruments/augment.py), each on every frame, with a strength drawn by the number of the frame: the
same for all --weights. A detector that learned without a change shows by its loss what learning with it is worth. Writes a table in Markdown.
Needs PyTorch, NumPy and OpenCV.
"""

import argparse
import dataclasses
from pathlib import Path

from instruments import folds as fold_files


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, type=Path)
    p.add_argument("--fold", required=True, help="the frames of the operations of this fold, which the weights must not have learned from")
    p.add_argument("--folds", type=Path, default=fold_files.SHIPPED, help="file of folds (default: %(default)s)")
    p.add_argument("--weights", required=True, type=Path, action="append", help="weights.pt of train_detector.py; may be given again")
    p.add_argument("--network", default="lite0")
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--every", type=int, default=1, help="only every n-th frame")
    p.add_argument("--threads", type=int, default=2)
    return p.parse_args()


def changed(frame, name, number, statistics):
    """`frame` with its picture changed by `name`; the colours of `colour` are those of another frame."""
    import numpy as np

    from instruments.augment import CHANGES, transfer_colour

    rng = np.random.default_rng((1, number))
    picture = frame.picture.copy()
    if name == "colour":
        picture = transfer_colour(picture, statistics[number], statistics[int(rng.integers(len(statistics)))], 1.0)
    else:
        picture = CHANGES[name][0](picture, rng)
    return dataclasses.replace(frame, picture=picture)


def main():
    a = arguments()
    try:
        import cv2
        import numpy as np
        import torch

        from instruments import networks
        from instruments.augment import NAMES, lab_statistics
        from instruments.data import CLASSES, read
        from instruments.score import average_precision, detect
    except ModuleNotFoundError as missing:
        raise SystemExit(f"{missing.name} is not installed: PyTorch, NumPy and OpenCV are needed") from None
    torch.set_num_threads(a.threads)
    cv2.setNumThreads(1)
    try:
        file = fold_files.read(a.folds)
        operations = file.held_out(a.fold)
    except fold_files.FoldsError as wrong:
        raise SystemExit(str(wrong)) from None
    frames = [f for split in file.splits for f in read(a.data, split) if f.group in operations][:: a.every]
    if not frames:
        raise SystemExit(f"{a.data}: no frame of the operations {', '.join(operations)}")
    frames = [f.load(a.width * 5 // 4) for f in frames]
    statistics = [lab_statistics(f.picture) for f in frames]
    models = []
    for path in a.weights:
        model = networks.build(a.network, len(CLASSES))
        try:
            networks.start(model, a.network, path)
        except (OSError, ValueError) as wrong:
            raise SystemExit(f"--weights {path}: {wrong}") from None
        models.append(model)
    print(f"mAP50 on {len(frames)} frames of fold {a.fold}, {a.width}x{a.height}\n")
    print("| change | " + " | ".join(f"{p.parent.parent.name}/{p.parent.name}" for p in a.weights) + " |")
    print("|---|" + "---|" * len(models), flush=True)
    before = None
    for name in (None, *NAMES):
        shown = frames if name is None else [changed(f, name, i, statistics) for i, f in enumerate(frames)]
        values = [float(np.nanmean(average_precision(shown, detect(m, shown, a.width, a.height), len(CLASSES)))) for m in models]
        before = before or values
        cells = [f"{v:.3f}" if name is None else f"{v:.3f} ({v - b:+.3f})" for v, b in zip(values, before)]
        print(f"| {'none' if name is None else f'`{name}`'} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
