#!/usr/bin/env python3
"""Teaches an exported detector or segmenter what the pictures look like that it learned from, without training or exporting it again.

    python3 know_pictures.py --model instruments.onnx --learned-from FRAMES ... --out instruments_new.onnx [--compare OTHER_PICTURES ...]

Adds the output `features` to a file of the YOLOX family or of export_masks.py (its features of stride 8, averaged over cells of 32 x 32 px) and
statistics of the frames in --learned-from, a folder of each kind, to its metadata, so that the nodes `yolo` and `mask_rcnn` warn of pictures unlike them. Its weights and other answers stay as they are to the last bit.
--compare names folders of pictures, or VOC, COCO, VIA or YOLO data, and prints how unlike they are: medians and quantiles as shares of the limit.
Needs onnx, onnxruntime, NumPy and OpenCV.
"""

import argparse
from pathlib import Path


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--model", required=True, type=Path)
    p.add_argument("--learned-from", required=True, type=Path, nargs="+", metavar="FOLDER", help="frames it learned from; a folder of each kind")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--compare", nargs="*", default=[], type=Path, metavar="FOLDER", help="other pictures, to print how unlike they are")
    p.add_argument("--most-pictures", type=int, default=1500, help="most frames that are looked at (default: %(default)s)")
    p.add_argument("--threads", type=int, default=2)
    a = p.parse_args()
    for path in (a.model, *a.learned_from, *a.compare):
        if not path.exists():
            p.error(f"there is no {path}")
    if a.out.exists():
        p.error(f"--out: {a.out} exists and is not overwritten")
    try:
        import cv2
        import numpy as np
        import onnx

        from instruments import familiar, onnx_store, pictures, unlabelled
    except ModuleNotFoundError as missing:
        raise SystemExit(f"this needs {missing.name}: pip install numpy opencv-python-headless onnx onnxruntime") from None

    model = onnx.load(str(a.model))
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    if metadata.get("family") not in ("yolox", "torchvision"):
        raise SystemExit(f"{a.model}: its metadata does not say that it is of the family yolox or torchvision, whose pictures alone this script can prepare")
    shape = [d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim]
    height, width = shape[2:]
    onnx_store.write_model(model, a.out, metadata, onnx_store.add_features)
    kinds = [familiar.learned_from(a.out, folder, width, height, a.threads, a.most_pictures) for folder in a.learned_from]
    metadata |= pictures.metadata_of(kinds)
    onnx_store.write(a.out, metadata)
    session = familiar.Session(a.out, a.threads)
    for folder in a.compare:
        rows = [familiar.picture_features(session, picture, width, height) for _, _, picture in unlabelled.pictures_of(folder)]
        shares = np.min([kind.unlikeness(rows) / kind.limit for kind in kinds], axis=0)
        low, middle, high = np.quantile(shares, (0.05, 0.5, 0.95))
        print(f"{folder}: {len(shares)} pictures, median {middle:.2f} of the limit, 5 % {low:.2f}, 95 % {high:.2f}, above it {100 * (shares > 1).mean():.0f} %")


if __name__ == "__main__":
    main()
