#!/usr/bin/env python3
"""Renders frames of the phantom with instruments and their exact outlines: pictures and one COCO file per split.

    python3 make_phantom_frames.py --panoscope target/debug/panoscope --out frames [--scenes 60] [--frames 16]

Each instrument has the position of its tip, px, and 1 where it is seen, 0 where it is hidden or outside (`tip` of its annotation).

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

[nodes.lead]
type = "write_table"
inputs = {{ tip = "scope.lead" }}
params = {{ path = "lead.jsonl" }}

[nodes.tips]
type = "write_table"
inputs = {{ table = "scope.clearance" }}
params = {{ path = "tips.jsonl" }}
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


def tips_of(lead, tables):
    """Tips by frame and instrument: column and row in px, and whether it is seen. `lead`: lines with px and mm, which give the camera."""
    rows, places = [], []
    for tip in filter(None, (line.get("tip") for line in lead)):
        x, y, z = tip["xyz_mm"]
        rows += [[x / z, 1, 0], [y / z, 0, 1]]
        places += [tip["u_px"], tip["v_px"]]
    if not rows:
        return {}
    focal, u, v = np.linalg.lstsq(np.array(rows), np.array(places), rcond=None)[0]
    found = {}
    for line in tables:
        for t in line.get("table") or []:
            if t["z_mm"] > 0:
                place = [focal * t["x_mm"] / t["z_mm"] + u, focal * t["y_mm"] / t["z_mm"] + v]
                found[line["seq"], t["track_id"]] = [*(round(float(value), 2) for value in place), int(t["seen"])]
    return found


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
        lines = lambda name: [json.loads(line) for line in (folder / name).read_text().splitlines()]
        tips = tips_of(lines("lead.jsonl"), lines("tips.jsonl"))
        into = splits["val" if scene % 6 == 5 else "train"]
        into["categories"] = truth["categories"]
        first = len(into["images"])
        number, seq = {}, {}
        for i in truth["images"]:
            seq[i["id"]] = int(Path(i["file_name"]).stem)
            number[i["id"]] = first + len(number)
            into["images"].append({**i, "id": number[i["id"]], "file_name": f"{folder.name}/{i['file_name']}"})
        for n in truth["annotations"]:
            n.pop("score", None)
            tip = tips.get((seq[n["image_id"]], n["track_id"]))
            n |= {"tip": tip} if tip else {}
            into["annotations"].append({**n, "id": len(into["annotations"]) + 1, "image_id": number[n["image_id"]]})
        print(f"scene {scene + 1} of {a.scenes}", flush=True)
    for name, held in splits.items():
        (a.out / f"{name}.json").write_text(json.dumps(held))
        print(f"{name}: {len(held['images'])} frames, {len(held['annotations'])} instruments")


if __name__ == "__main__":
    main()
