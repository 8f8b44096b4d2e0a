#!/usr/bin/env python3
"""Renders pairs unless they are there, matches them by Panoscope's matchers, and writes both as arrays that `train_refiner.py` reads."""

import argparse
import json
import subprocess
from pathlib import Path

RENDERED = ("left", "right", "disparity", "visible", "lit")
MAPS = ("bm", "bm_right", "bm2", "bm2_right", "sgbm", "sgbm_right")
STEPS = 64  # of a pixel of disparity, in all arrays of two bytes
PLANES = {"left": "u1", "right": "u1", "disparity": "i2", "visible": "u1", "lit": "u1"}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matcher", type=Path, help="the program: cargo build -p panoscope-stereo --example match_pairs; without it pairs are only rendered")
    parser.add_argument("--out", type=Path, required=True, help="folder of the arrays")
    parser.add_argument("--pairs", type=int, default=2000, help="pairs to render (2.4 MB each)")
    parser.add_argument("--first-seed", type=int, default=0, help="seed of the first pair; the others follow")
    parser.add_argument("--width", type=int, default=448, help="columns, a multiple of 16")
    parser.add_argument("--height", type=int, default=336, help="rows, a multiple of 16")
    return parser.parse_args()


def render_all(options):
    """Writes views and truth of all pairs."""
    import cv2
    import numpy as np

    from refiner.scenes import render

    cv2.setNumThreads(1)
    files = {name: (options.out / f"{name}.{PLANES[name]}").open("wb") for name in RENDERED}
    for number in range(options.pairs):
        pair = render(options.first_seed + number, options.height, options.width)
        pair.disparity = np.rint(pair.disparity * STEPS)
        for name, file in files.items():
            file.write(getattr(pair, name).astype(PLANES[name]).tobytes())
        if (number + 1) % 100 == 0:
            print(f"{number + 1} of {options.pairs} pairs rendered", flush=True)
    for file in files.values():
        file.close()


def match_all(options, about):
    """Writes the maps of all pairs."""
    view = about["height"] * about["width"]
    program = subprocess.Popen([options.matcher, str(about["width"]), str(about["height"])], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    views = [(options.out / f"{name}.u1").open("rb") for name in ("left", "right")]
    files = [(options.out / f"{name}.i2").open("wb") for name in MAPS]
    for number in range(about["pairs"]):
        program.stdin.write(b"".join(file.read(view) for file in views))
        program.stdin.flush()
        for file in files:
            map_bytes = program.stdout.read(2 * view)
            if len(map_bytes) != 2 * view:
                raise SystemExit(f"{options.matcher} ended after {number} pairs")
            file.write(map_bytes)
        if (number + 1) % 100 == 0:
            print(f"{number + 1} of {about['pairs']} pairs matched", flush=True)
    for file in files:
        file.close()
    program.stdin.close()


def main():
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    about_file = options.out / "about.json"
    if not about_file.exists():
        render_all(options)
        about = {"pairs": options.pairs, "height": options.height, "width": options.width, "first_seed": options.first_seed}
        about_file.write_text(json.dumps(about))
    if options.matcher:
        match_all(options, json.loads(about_file.read_text()))


if __name__ == "__main__":
    main()
