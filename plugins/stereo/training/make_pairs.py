#!/usr/bin/env python3
"""Renders pairs, matches them by Panoscope's matchers, and writes both as arrays that `train_matcher.py` reads."""

import argparse
import json
import subprocess
from pathlib import Path

import cv2
import numpy as np

from matcher.pairs import MATCHERS, PLANES, STEPS
from matcher.scenes import render

# Pairs after which the arrays are whole: a training may start on them.
WHOLE = 50


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matcher", type=Path, required=True, help="the program: cargo build -p panoscope-stereo --example match_pairs")
    parser.add_argument("--out", type=Path, required=True, help="folder of the arrays")
    parser.add_argument("--pairs", type=int, default=2000, help="pairs to render (2.4 MB each)")
    parser.add_argument("--first-seed", type=int, default=0, help="seed of the first pair; the others follow")
    parser.add_argument("--width", type=int, default=448, help="columns, a multiple of 32")
    parser.add_argument("--height", type=int, default=336, help="rows, a multiple of 16")
    return parser.parse_args()


def matched(program, pair):
    """Maps of the left view of a pair, one per matcher, as the bytes that the program writes."""
    program.stdin.write(b"".join(cv2.cvtColor(view, cv2.COLOR_RGB2GRAY).tobytes() for view in (pair.left, pair.right)))
    program.stdin.flush()
    for name in MATCHERS:
        made = program.stdout.read(2 * pair.disparity.size)
        if len(made) != 2 * pair.disparity.size:
            raise SystemExit("the matcher ended early")
        yield name, made


def main():
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    kinds = {name: kind for name, (kind, _) in PLANES.items()} | {name: "i2" for name in MATCHERS}
    files = {name: (options.out / f"{name}.{kind}").open("wb") for name, kind in kinds.items()}
    about = {"height": options.height, "width": options.width, "first_seed": options.first_seed}
    program = subprocess.Popen([options.matcher, str(options.width), str(options.height)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    for number in range(options.pairs):
        pair = render(options.first_seed + number, options.height, options.width)
        for name, made in matched(program, pair):
            files[name].write(made)
        pair.disparity = np.rint(pair.disparity * STEPS)
        for name, (kind, _) in PLANES.items():
            files[name].write(getattr(pair, name).astype(kind).tobytes())
        if (number + 1) % WHOLE == 0 or number + 1 == options.pairs:
            for file in files.values():
                file.flush()
            (options.out / "about.json").write_text(json.dumps({"pairs": number + 1, **about}))
            print(f"{number + 1} of {options.pairs} pairs", flush=True)
    program.stdin.close()


if __name__ == "__main__":
    main()
