#!/usr/bin/env python3
"""Renders frames of the phantom with instruments and their exact outlines: pictures and one COCO file per split.

    python3 make_phantom_frames.py --panoscope target/debug/panoscope --out frames [--scenes 60] [--frames 16]

Every scene has its own seed, tissue, light, smoke, number and order of instruments, all drawn from --seed; whole scenes go to `train.json` or
(every sixth) to `val.json`. train_masks.py learns from them; `panoscope eval detect` scores on val.json.
"""

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np

GRAPH = """# Frames of the phantom with exact outlines, written for training.
name = "phantom_frames"
mode = "batch"
plugins = ["phantom", "sinks"]

[nodes.scope]
type = "phantom"
params = {{ {params} }}

[nodes.pictures]
type = "write_images"
inputs = {{ image = "scope.left" }}
params = {{ path = "{{seq}}.jpg" }}

[nodes.truth]
type = "write_table"
inputs = {{ instances = "scope.instances" }}
params = {{ path = "truth.json", image_name = "{{seq}}.jpg" }}
"""


def scene_params(rng, width, height):
    """Parameters of one scene; a second apart, so that hardly two frames look alike."""
    chosen = {
        "scene": ["liver", "bowel", "cavity"][int(rng.integers(3))],
        "seed": int(rng.integers(1, 1_000_000)),
        "width": width,
        "height": height,
        "rate_hz": 1.0,
        "distance_mm": float(rng.integers(35, 90)),
        "tools": int(rng.choice([1, 2, 2, 3, 3, 4, 5])),
        "tool_motion": str(rng.choice(["sway", "strokes", "circle", "cross"])),
        "speed_mm_s": float(rng.integers(0, 15)),
        "specular": round(float(rng.uniform(0.3, 2.0)), 1),
        "noise": round(float(rng.uniform(0.3, 2.5)), 1),
        "smoke": float(rng.choice([0.0, 0.0, 0.0, 0.2, 0.4])),
        "blood_drops": int(rng.choice([0, 0, 0, 2, 4])),
    }
    text = {k: f'"{v}"' if isinstance(v, str) else v for k, v in chosen.items()}
    return ", ".join(f"{k} = {v}" for k, v in text.items())


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--panoscope", required=True, type=Path, help="the program")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--scenes", type=int, default=60)
    p.add_argument("--frames", type=int, default=16, help="frames of each scene")
    p.add_argument("--width", type=int, default=640)
    p.add_argument("--height", type=int, default=360)
    p.add_argument("--seed", type=int, default=1)
    a = p.parse_args()
    rng = np.random.default_rng(a.seed)
    splits = {"train": {"images": [], "annotations": [], "categories": []}, "val": {"images": [], "annotations": [], "categories": []}}
    for scene in range(a.scenes):
        folder = a.out / f"scene{scene:03}"
        folder.mkdir(parents=True, exist_ok=True)
        graph = folder / "graph.toml"
        text = GRAPH.format(params=scene_params(rng, a.width, a.height))
        truth_file = folder / "truth.json"
        if not (graph.exists() and graph.read_text() == text and truth_file.exists()):
            graph.write_text(text)
            command = [str(a.panoscope.resolve()), "run", str(graph.resolve()), "--headless", "--unpaced", "--frames", str(a.frames)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode != 0:
                raise SystemExit(f"scene {scene} failed:\n{done.stdout}{done.stderr}")
        truth = json.loads(truth_file.read_text())
        into = splits["val" if scene % 6 == 5 else "train"]
        into["categories"] = truth["categories"]
        first = len(into["images"])
        number = {}
        for i in truth["images"]:
            number[i["id"]] = first + len(number)
            into["images"].append({**i, "id": number[i["id"]], "file_name": f"{folder.name}/{i['file_name']}"})
        for n in truth["annotations"]:
            n.pop("score", None)
            into["annotations"].append({**n, "id": len(into["annotations"]) + 1, "image_id": number[n["image_id"]]})
        print(f"scene {scene + 1} of {a.scenes}", flush=True)
    for name, held in splits.items():
        (a.out / f"{name}.json").write_text(json.dumps(held))
        print(f"{name}: {len(held['images'])} frames, {len(held['annotations'])} instruments")


if __name__ == "__main__":
    main()
