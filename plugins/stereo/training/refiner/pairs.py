"""Batches from the arrays that `make_pairs.py` wrote."""

import json
from pathlib import Path

import cv2
import numpy as np
import torch

from .network import UNKNOWN

PLANES = {"left": "u1", "right": "u1", "disparity": "i2", "visible": "u1", "lit": "u1"}
MATCHERS = ("bm", "bm2", "sgbm")
STEPS = 64.0
# Pairs at the end of each folder that are kept for scores.
KEPT = 48
# Disparities that differ more from one pixel to the next make an edge, px; pixels this near to it count more.
EDGE_STEP_PX, EDGE_PX = 1.5, 5


class Folder:
    """One folder of arrays."""

    def __init__(self, path):
        path = Path(path)
        about = json.loads((path / "about.json").read_text())
        self.pairs, self.size = about["pairs"], (about["height"], about["width"])
        kinds = {**PLANES, **{name + side: "i2" for name in MATCHERS for side in ("", "_right")}}
        self.arrays = {}
        for name, kind in kinds.items():
            stored = np.memmap(path / f"{name}.{kind}", kind, "r")
            plane = self.size[0] * self.size[1]
            self.arrays[name] = stored[: self.pairs * plane].reshape(self.pairs, *self.size)

    def pair(self, index, matcher, rows):
        """The planes of a pair: views 0 to 255, maps and truth in px."""
        cut = {name: np.asarray(self.arrays[name][index, rows]) for name in PLANES}
        for side in ("", "_right"):
            steps = np.asarray(self.arrays[matcher + side][index, rows])
            cut["map" + side] = np.where(steps == -32768, UNKNOWN, steps / STEPS).astype(np.float32)
        cut["disparity"] = cut["disparity"] / np.float32(STEPS)
        return cut


def edges(disparity):
    """1 within EDGE_PX of an edge of the true disparity."""
    step = np.zeros(disparity.shape, np.uint8)
    step[:, 1:] |= (np.abs(np.diff(disparity, axis=1)) > EDGE_STEP_PX).astype(np.uint8)
    step[1:] |= (np.abs(np.diff(disparity, axis=0)) > EDGE_STEP_PX).astype(np.uint8)
    return cv2.dilate(step, np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8))


def vary(planes, rng):
    """Upside down, brighter or darker, without the right view or its map."""
    if rng.random() < 0.5:
        planes = {name: plane[::-1] for name, plane in planes.items()}
    gain, gamma = rng.uniform(0.6, 1.4), rng.uniform(0.8, 1.25)
    for name in ("left", "right"):
        planes[name] = np.clip(255 * gain * (planes[name] / 255.0) ** gamma, 0, 255)
    if rng.random() < 0.06:
        planes["right"] = np.zeros_like(planes["right"])
    if rng.random() < 0.06:
        planes["map_right"] = np.full_like(planes["map_right"], UNKNOWN)
    return planes


def tensors(all_planes):
    """Inputs of the network, and truth, visibility and weights, each batch x 1 x rows x columns."""
    stack = lambda name, scale=1.0: torch.from_numpy(np.stack([np.ascontiguousarray(p[name], np.float32) * np.float32(scale) for p in all_planes])[:, None])
    inputs = (stack("left", 1 / 255), stack("right", 1 / 255), stack("map"), stack("map_right"))
    near = torch.from_numpy(np.stack([edges(np.ascontiguousarray(p["disparity"])) for p in all_planes])[:, None].astype(np.float32))
    return inputs, stack("disparity"), stack("visible"), stack("lit"), near


class Batches:
    """Endless random batches of the pairs of several folders; the same for the same seed."""

    def __init__(self, folders, batch, rows, seed):
        self.folders, self.batch, self.rows = [Folder(path) for path in folders], batch, rows
        self.rng = np.random.default_rng(seed)
        self.counts = np.array([max(folder.pairs - KEPT, 1) for folder in self.folders])

    def __next__(self):
        made = []
        for _ in range(self.batch):
            number = int(self.rng.integers(self.counts.sum()))
            which = int(np.searchsorted(np.cumsum(self.counts), number, side="right"))
            folder = self.folders[which]
            index = number - int(self.counts[:which].sum())
            first = 2 * int(self.rng.integers((folder.size[0] - self.rows) // 2 + 1))
            planes = folder.pair(index, MATCHERS[self.rng.choice(3, p=[0.35, 0.3, 0.35])], slice(first, first + self.rows))
            made.append(vary(planes, self.rng))
        return tensors(made)


def kept(folder, matcher):
    """The pairs for scores, one at a time, whole."""
    folder = Folder(folder)
    rows = slice(0, folder.size[0] // 32 * 32)
    for index in range(max(folder.pairs - KEPT, 0), folder.pairs):
        yield tensors([folder.pair(index, matcher, rows)])
