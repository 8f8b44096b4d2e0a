#!/usr/bin/env python3
"""Makes pictures without instruments for know_empty.py: drawn cavities, tissue of the phantom, and parts of real frames beside their instruments.

    python3 make_empty_frames.py --out empty --data FRAMES --panoscope target/debug/panoscope --also FOLDER ...

Writes the folders `cavities`, `crops` (with --data) and `tissue` (with --panoscope). All that is drawn or rendered has an even seed, and of the pictures of
--also the first, third and so on are taken: `panoscope eval detect --case no_instruments` scores on the others. Files that are there stay.
"""

import argparse
import subprocess
from pathlib import Path

import cv2
import numpy as np

from instruments.box_masks import lit
from instruments.cavities import frame
from instruments.data import read

GRAPH = """mode = "batch"
plugins = ["phantom", "sinks"]

[nodes.scope]
type = "phantom"
params = {{ {params} }}

[nodes.pictures]
type = "write_images"
inputs = {{ image = "scope.left" }}
params = {{ path = "{{seq}}.jpg" }}
"""
# Size at which frames are searched for parts without instruments; how red tissue is at least, and how much metal is overlooked.
WIDTH, HEIGHT = 320, 180
RED, OVERLOOKED = 0.12, 0.008


def part_without(picture, size, boxes, rng, tries=150):
    """The largest of `tries` random parts without label and metal; `None` where there is none. `boxes` are of a picture of `size`."""
    small = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    light = lit(small)
    b, g, r = cv2.split(small.astype(np.float32))
    metal = ((r - b) / (r + g + b + 30) < RED) & light & (r + g + b > 75)
    metal = cv2.morphologyEx(metal.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    labelled = np.zeros((HEIGHT, WIDTH), bool)
    for x0, y0, x1, y1 in boxes * np.array([WIDTH / size[0], HEIGHT / size[1]] * 2):
        mx, my = 0.15 * (x1 - x0) + 4, 0.15 * (y1 - y0) + 4
        labelled[max(0, int(y0 - my)) : int(y1 + my) + 1, max(0, int(x0 - mx)) : int(x1 + mx) + 1] = True
    best = None
    for _ in range(tries):
        w = rng.uniform(0.3, 0.8) * WIDTH
        h = w * rng.choice([9 / 16, 3 / 4])
        if h > HEIGHT - 2:
            continue
        x, y = rng.uniform(0, WIDTH - w), rng.uniform(0, HEIGHT - h)
        part = np.s_[int(y) : int(y + h), int(x) : int(x + w)]
        if (best is None or w > best[2]) and not labelled[part].any() and metal[part].mean() <= OVERLOOKED and light[part].mean() >= 0.6:
            best = (x, y, w, h)
    if best is None:
        return None
    x, y, w, h = (np.array(best) * np.array([picture.shape[1] / WIDTH, picture.shape[0] / HEIGHT] * 2)).astype(int)
    return picture[y : y + h, x : x + w]


def tissue_params(seed):
    """Parameters of a scene of the phantom without instruments."""
    rng = np.random.default_rng(seed)
    wide = rng.random() < 0.25
    chosen = {
        "scene": str(rng.choice(["liver", "bowel", "cavity"])),
        "seed": seed,
        "width": 640,
        "height": int(rng.choice([360, 480])),
        "rate_hz": 1.0,
        "distance_mm": float(rng.integers(25, 100)),
        "texture": round(float(rng.uniform(0, 1)), 2),
        "specular": round(float(rng.uniform(0.3, 3)), 1),
        "light": round(float(rng.uniform(0.4, 1.5)), 2),
        "noise": round(float(rng.uniform(0.3, 2.5)), 1),
        "smoke": float(rng.choice([0.0, 0.0, 0.2, 0.4])),
        "blood_drops": int(rng.choice([0, 0, 2, 4])),
        "zoom": 0.45 if wide else 1.0,
        "lens": "equidistant" if wide else "pinhole",
    }
    return ", ".join(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in chosen.items())


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--data", type=Path, help="real frames with boxes, for `crops`")
    p.add_argument("--splits", nargs="+", default=["train", "val"])
    p.add_argument("--without", default="", help="operations of which no parts are taken, separated by commas")
    p.add_argument("--panoscope", type=Path, help="the program, for `tissue`")
    p.add_argument("--also", type=Path, nargs="*", default=[], help="folders of pictures without instruments")
    p.add_argument("--cavities", type=int, default=300, help="number of drawn pictures")
    p.add_argument("--scenes", type=int, default=40, help="scenes of the phantom, of eight frames each")
    a = p.parse_args()
    cv2.setNumThreads(1)

    def folder(name):
        (a.out / name).mkdir(parents=True, exist_ok=True)
        return a.out / name

    def write(path, picture):
        if picture is not None:
            cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 95])

    if a.data:
        left_out = set(filter(None, a.without.split(",")))
        frames = [f for split in a.splits for f in read(a.data, split) if f.group not in left_out]
        for f in frames:
            rng = np.random.default_rng(sum(map(ord, f.name)))
            write(folder("crops") / f"{f.name}.jpg", part_without(cv2.imread(str(f.path)), f.size, f.boxes[:, 1:], rng))
        print(f"crops: {len(list(folder('crops').iterdir()))} of {len(frames)} frames", flush=True)
    for number, source in enumerate(a.also):
        pictures = sorted(path for path in source.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg"))
        for path in pictures[::2]:
            link = folder(f"also{number}") / path.name
            if not link.exists():
                link.symlink_to(path.resolve())
    for scene in range(a.scenes if a.panoscope else 0):
        into, seed = folder("tissue"), 2 * scene
        work = folder(f"work/scene{scene:03}")
        if not (into / f"{scene:03}_7.jpg").exists():
            (work / "graph.toml").write_text(GRAPH.format(params=tissue_params(seed)))
            command = [str(a.panoscope.resolve()), "run", str((work / "graph.toml").resolve()), "--headless", "--unpaced", "--frames", "8"]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode != 0:
                raise SystemExit(f"scene {scene} failed:\n{done.stdout}{done.stderr}")
            for picture in work.glob("*.jpg"):
                picture.rename(into / f"{scene:03}_{int(picture.stem)}.jpg")
    for number in range(a.cavities):
        seed = 2 * number
        path = folder("cavities") / f"{seed:05}.jpg"
        if not path.exists():
            write(path, frame(seed, 640, (360, 480)[number % 2]))


if __name__ == "__main__":
    main()
