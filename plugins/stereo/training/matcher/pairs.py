"""Batches from the arrays that `make_pairs.py` wrote."""

import json
from pathlib import Path

import cv2
import numpy as np
import torch

from .network import GRAIN, KNOWN_ABOVE, RANGE_PX, UNKNOWN

# Kind of number and planes of each array.
PLANES = {"left": ("u1", 3), "right": ("u1", 3), "disparity": ("i2", 1), "visible": ("u1", 1), "lit": ("u1", 1)}
# Maps of the left view by our matchers, as `make_pairs.py` names them, and how often a sample has each; the rest has none.
MATCHERS = {"bm": 0.3, "bm2": 0.05, "sgbm": 0.55}
# Pairs that `sgbm` matches as photographs of textured scenes: it knows this share at least, with this mean error at most, px. Others are drawn OTHERS_DRAWN times as often:
# a network that learns from poor hints trusts good ones too little.
WELL_KNOWN, WELL_MATCHED_PX, OTHERS_DRAWN = 0.6, 1.5, 0.06
# Of a pixel of disparity.
STEPS = 64
# Pairs at the start of the first folder that are kept for scores.
KEPT = 40
# Disparities that differ more from one pixel to the next make an edge, px; pixels this near to it count more.
EDGE_STEP_PX, EDGE_PX = 1.5, 5


class Folder:
    """One folder of arrays, which may still grow."""

    def __init__(self, path):
        self.path = Path(path)
        about = json.loads((self.path / "about.json").read_text())
        self.size = (about["height"], about["width"])
        self.open()

    def open(self):
        """Sees the pairs that are there now."""
        self.pairs = json.loads((self.path / "about.json").read_text())["pairs"]
        self.arrays = {}
        for name, (kind, planes) in PLANES.items():
            stored = np.memmap(self.path / f"{name}.{kind}", kind, "r")
            shape = (self.pairs, *self.size) + ((3,) if planes == 3 else ())
            self.arrays[name] = stored[: int(np.prod(shape))].reshape(shape)
        for name in MATCHERS:
            stored = np.memmap(self.path / f"{name}.i2", "i2", "r")
            self.arrays[name] = stored[: self.pairs * self.size[0] * self.size[1]].reshape(self.pairs, *self.size)
        self.drawn = np.array([self.share_drawn(index) for index in range(self.pairs)])

    def share_drawn(self, index):
        """How often a pair is drawn, compared with a well-matched one."""
        steps, truth = (self.arrays[name][index, 4::8, 4::8].astype(np.float32) for name in ("sgbm", "disparity"))
        known = steps > -32768
        error_px = np.minimum(np.abs(steps - truth)[known] / STEPS, 20.0)
        return 1.0 if known.mean() > WELL_KNOWN and error_px.mean() < WELL_MATCHED_PX else OTHERS_DRAWN

    def pair(self, index, rows, matcher):
        """The planes of a pair: views 0 to 255, truth and the map of a matcher, or none, in px."""
        cut = {name: np.array(self.arrays[name][index, rows]) for name in PLANES}
        cut["disparity"] = cut["disparity"] / np.float32(STEPS)
        cut["map"] = np.full(cut["disparity"].shape, UNKNOWN, np.float32)
        if matcher:
            steps = self.arrays[matcher][index, rows]
            known = steps > -32768
            cut["map"][known] = steps[known] / np.float32(STEPS)
        return cut


def filled_rows(map):
    """Unknown pixels take the smaller of the nearest known values of their row, because what is hidden lies behind; rows that know nothing take the values of the nearest
    row that does. A map that knows nothing stays UNKNOWN."""
    columns = np.arange(map.shape[1])
    known = map > KNOWN_ABOVE
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, len(columns))[:, ::-1], axis=1)[:, ::-1]
    left = np.where(before >= 0, np.take_along_axis(map, np.maximum(before, 0), 1), np.inf)
    right = np.where(after < len(columns), np.take_along_axis(map, np.minimum(after, len(columns) - 1), 1), np.inf)
    filled = np.minimum(left, right)
    rows = np.flatnonzero(known.any(1))
    if not len(rows):
        return np.full(map.shape, UNKNOWN, np.float32)
    nearest = rows[np.abs(rows - np.arange(len(map))[:, None]).argmin(1)]
    return filled[nearest].astype(np.float32)


def edges(disparity):
    """1 within EDGE_PX of an edge of the true disparity."""
    step = np.zeros(disparity.shape, np.uint8)
    step[:, 1:] |= (np.abs(np.diff(disparity, axis=1)) > EDGE_STEP_PX).astype(np.uint8)
    step[1:] |= (np.abs(np.diff(disparity, axis=0)) > EDGE_STEP_PX).astype(np.uint8)
    return cv2.dilate(step, np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8))


def enlarge(planes, rng):
    """A part of the pair at up to 1.4 times its size, so that disparities reach further."""
    rows, columns = planes["disparity"].shape
    most = min(1.4, 0.95 * RANGE_PX / max(float(planes["disparity"].max()), 1.0))
    if most <= 1.05:
        return planes
    factor = rng.uniform(1.0, most)
    high, wide = int(rows / factor), int(columns / factor)
    top, start = int(rng.integers(rows - high + 1)), int(rng.integers(columns - wide + 1))
    grown = {}
    for name, plane in planes.items():
        how = cv2.INTER_LINEAR if name in ("left", "right") else cv2.INTER_NEAREST
        grown[name] = cv2.resize(plane[top : top + high, start : start + wide], (columns, rows), interpolation=how)
    grown["disparity"] = grown["disparity"] * np.float32(columns / wide)
    known = grown["map"] > KNOWN_ABOVE
    grown["map"][known] *= np.float32(columns / wide)
    # What moved out of the part on the left is not shown any more.
    x = np.arange(columns, dtype=np.float32)[None]
    grown["visible"] = grown["visible"] * (x - grown["disparity"] >= 0).astype(np.uint8)
    return grown


def vary(planes, rng):
    """Upside down, larger, other colours, brighter or darker by itself."""
    if rng.random() < 0.5:
        planes = {name: plane[::-1] for name, plane in planes.items()}
    if rng.random() < 0.4:
        planes = enlarge({name: np.ascontiguousarray(plane) for name, plane in planes.items()}, rng)
    colour = np.exp(rng.normal(0, 0.15, 3)).astype(np.float32)
    order = rng.permutation(3) if rng.random() < 0.2 else np.arange(3)
    gray = rng.random() < 0.15
    gain, gamma = rng.uniform(0.6, 1.4), rng.uniform(0.8, 1.25)
    steps = np.linspace(0, 1, 256, dtype=np.float32) ** np.float32(gamma)
    for name in ("left", "right"):
        view = steps[planes[name]] * (colour * np.float32(gain * np.exp(rng.normal(0, 0.04))))
        view = view[..., order]
        if gray:
            view = np.repeat(view.mean(2, keepdims=True), 3, 2)
        planes[name] = np.clip(view, 0, 1)
    return planes


def tensors(all_planes):
    """Views, filled maps and where they are known, and truth, visibility, light and edges, each batch x planes x rows x columns."""
    stack = lambda name: torch.from_numpy(np.stack([np.ascontiguousarray(p[name], np.float32) for p in all_planes]))
    views = [stack(name).permute(0, 3, 1, 2).contiguous(memory_format=torch.channels_last) for name in ("left", "right")]
    near = torch.from_numpy(np.stack([edges(np.ascontiguousarray(p["disparity"])) for p in all_planes])[:, None].astype(np.float32))
    filled = torch.from_numpy(np.stack([filled_rows(p["map"]) for p in all_planes]))[:, None]
    inputs = (*views, filled, (stack("map")[:, None] > KNOWN_ABOVE).float())
    return inputs, *(stack(name)[:, None] for name in ("disparity", "visible", "lit")), near


class Batches:
    """Endless random batches of the pairs of several folders; the same for the same seed and pairs."""

    def __init__(self, folders, batch, rows, seed):
        self.folders, self.batch, self.rows = [Folder(path) for path in folders], batch, rows
        self.rng = np.random.default_rng(seed)

    def __next__(self):
        counts = np.array([max(folder.pairs - (KEPT if place == 0 else 0), 1) for place, folder in enumerate(self.folders)])
        made = []
        while len(made) < self.batch:
            number = int(self.rng.integers(counts.sum()))
            which = int(np.searchsorted(np.cumsum(counts), number, side="right"))
            folder = self.folders[which]
            index = number - int(counts[:which].sum()) + (KEPT if which == 0 else 0)
            index = min(index, folder.pairs - 1)
            if self.rng.random() > folder.drawn[index]:
                continue
            first = int(self.rng.integers(folder.size[0] - self.rows + 1))
            matcher = self.rng.choice([*MATCHERS, ""], p=[*MATCHERS.values(), 1 - sum(MATCHERS.values())])
            made.append(vary(folder.pair(index, slice(first, first + self.rows), matcher), self.rng))
        return tensors(made)

    def renew(self):
        for folder in self.folders:
            folder.open()


def kept(path, matcher):
    """The pairs for scores, one at a time, whole but for rows beyond a multiple of GRAIN."""
    folder = Folder(path)
    rows = slice(0, folder.size[0] // GRAIN * GRAIN)
    for index in range(min(KEPT, folder.pairs)):
        planes = folder.pair(index, rows, matcher)
        for name in ("left", "right"):
            planes[name] = planes[name] / np.float32(255)
        yield tensors([planes])
