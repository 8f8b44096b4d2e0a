"""Frames with outlines: the phantom's exact ones, guesses from boxes on real frames, and mixtures of both."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from . import via
from .augment import lab_statistics, light, photometric, transfer_colour
from .box_masks import masks_of
from .data import CLASSES, letterbox, normal_name, read, via_picture

DOUBT = 255


@dataclass
class Outlined:
    """A picture with the number of the instrument at each pixel: 0 none, 255 doubtful; `kinds[i]` is the class of instrument i + 1."""

    name: str
    real: bool
    picture: np.ndarray
    ids: np.ndarray
    kinds: list = field(default_factory=list)


def run_lengths(counts, height, width):
    """A mask from COCO's uncompressed run lengths (column by column, beginning with zeros)."""
    flat = np.repeat(np.arange(len(counts)) % 2, counts).astype(np.uint8)
    if flat.size != height * width:
        raise ValueError(f"run lengths cover {flat.size} pixels of {height * width}")
    return flat.reshape(width, height).T


def polygons(lists, height, width):
    mask = np.zeros((height, width), np.uint8)
    for points in lists:
        cv2.fillPoly(mask, [np.round(np.array(points).reshape(-1, 2)).astype(np.int32)], 1)
    return mask


def fit(picture, ids, width, height):
    """Both into the network's input, upper left, 114 beside."""
    out, _, scale = letterbox(picture, np.zeros((0, 5), np.float32), width, height)
    h, w = picture.shape[:2]
    size = (round(w * scale), round(h * scale))
    fitted = np.zeros((height, width), np.uint8)
    fitted[: size[1], : size[0]] = cv2.resize(ids, size, interpolation=cv2.INTER_NEAREST)
    return out, fitted


def read_coco(folder, split, width, height, real=False):
    """`split`.json in COCO's form with masks: run lengths or polygons."""
    folder = Path(folder)
    truth = json.loads((folder / f"{split}.json").read_text())
    names = {c["id"]: normal_name(c["name"]) for c in truth["categories"]}
    of = {}
    for a in truth["annotations"]:
        of.setdefault(a["image_id"], []).append(a)
    frames = []
    for i in truth["images"]:
        picture = cv2.imread(str(folder / i["file_name"]))
        if picture is None:
            raise ValueError(f"{folder / i['file_name']}: not a picture that can be read")
        h, w = picture.shape[:2]
        ids, kinds = np.zeros((h, w), np.uint8), []
        for a in of.get(i["id"], []):
            s = a["segmentation"]
            mask = run_lengths(s["counts"], *s["size"]) if isinstance(s, dict) else polygons(s, h, w)
            kinds.append(CLASSES.index(names[a["category_id"]]))
            ids[mask > 0] = len(kinds)
        frames.append(Outlined(i["file_name"], real, *fit(picture, ids, width, height), kinds))
    return frames


def read_via(folder, split, width, height):
    """Real frames with the outlines of `split`.json as VIA writes them."""
    path = Path(folder) / f"{split}.json"
    frames = []
    for name, regions in via.read(path):
        picture = cv2.imread(str(via_picture(folder, name)))
        if picture is None:
            raise ValueError(f"{path}: picture `{name}` cannot be read")
        h, w = picture.shape[:2]
        ids, kinds = np.zeros((h, w), np.uint8), []
        for number, (kind, outline) in enumerate(regions, 1):
            kind = normal_name(kind)
            if kind not in CLASSES:
                raise ValueError(f"{path}: picture `{name}`, region {number}: class `{kind}` is not one of {', '.join(CLASSES)}")
            kinds.append(CLASSES.index(kind))
            ids[polygons([outline], h, w) > 0] = len(kinds)
        frames.append(Outlined(name, True, *fit(picture, ids, width, height), kinds))
    print(f"{split}: {len(frames)} real frames with outlines", flush=True)
    return frames


def read_real(data, split, width, height, store):
    """Real frames: with outlines where they are VIA's, else with boxes and guessed outlines."""
    if via.is_via(Path(data) / f"{split}.json"):
        return read_via(data, split, width, height)
    return read_boxed(data, split, width, height, store)


def read_boxed(data, split, width, height, store):
    """Real frames with boxes; outlines are guessed once and kept in the folder `store`."""
    frames = read(data, split)
    key = hashlib.sha256(f"{width}x{height} {split} {len(frames)} {[f.name for f in frames]}".encode()).hexdigest()[:12]
    kept = Path(store) / f"box_masks_{key}.npz"
    # Unpacked once: every look into the archive unpacks all of it anew.
    held = np.load(kept)["ids"] if kept.exists() else None
    out, all_ids, good = [], [], 0
    for n, f in enumerate(frames):
        picture = cv2.imread(str(f.path))
        if picture is None:
            raise ValueError(f"{f.path}: not a picture that can be read")
        boxes = f.boxes * np.array([1, *(picture.shape[1] / f.size[0], picture.shape[0] / f.size[1]) * 2], np.float32)
        picture, boxes, _ = letterbox(picture, boxes, width, height)
        if held is not None:
            ids = held[n]
        else:
            ids = np.zeros((height, width), np.uint8)
            guesses = masks_of(picture, boxes)
            for mask, region in guesses:
                if mask is None:
                    ids[region] = DOUBT
            for i, (mask, _) in enumerate(guesses):
                if mask is not None:
                    ids[mask] = i + 1
            if n % 200 == 0:
                print(f"outlines from boxes: {n} of {len(frames)} frames", flush=True)
        all_ids.append(ids)
        good += sum((ids == i + 1).any() for i in range(len(boxes)))
        out.append(Outlined(f.name, True, picture, ids, [int(k) for k in boxes[:, 0]]))
    if held is None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(kept, ids=np.array(all_ids))
    print(f"{split}: {len(out)} real frames, {good} of {sum(len(f.kinds) for f in out)} boxes gave an outline", flush=True)
    return out


def targets_of(ids, kinds, least=40):
    """Boxes, labels (from 1), masks and doubtful boxes of one picture; instruments of fewer than `least` px are doubtful."""
    boxes, labels, masks, ignored = [], [], [], []

    def box(mask):
        ys, xs = mask.any(1).nonzero()[0], mask.any(0).nonzero()[0]
        return [xs[0], ys[0], xs[-1] + 1, ys[-1] + 1]

    for i, kind in enumerate(kinds):
        mask = ids == i + 1
        area = int(mask.sum())
        if area == 0:
            continue
        b = box(mask)
        if area < least or b[2] - b[0] < 4 or b[3] - b[1] < 4:
            ignored.append(b)
            continue
        boxes.append(b)
        labels.append(kind + 1)
        masks.append(mask)
    count, parts = cv2.connectedComponents((ids == DOUBT).astype(np.uint8))
    ignored += [box(parts == i) for i in range(1, count)]
    h, w = ids.shape
    return {
        "boxes": np.array(boxes, np.float32).reshape(-1, 4),
        "labels": np.array(labels, np.int64),
        "masks": np.array(masks, np.uint8).reshape(-1, h, w),
        "ignored": np.array(ignored, np.float32).reshape(-1, 4),
    }


class Mixed:
    """Endless, seeded samples: phantom frames in real colours, and real frames with instruments of other frames set in along their outlines."""

    def __init__(self, phantom, real, width, height, seed, phantom_share=0.4):
        self.phantom, self.real, self.width, self.height, self.seed = phantom, real, width, height, seed
        self.phantom_share = phantom_share if phantom and real else float(bool(phantom))
        self.statistics = {id(f): lab_statistics(f.picture) for f in (*phantom, *real)}
        self.real_statistics = [self.statistics[id(f)] for f in real] or [self.statistics[id(f)] for f in phantom]
        donors = [(f, i + 1) for f in (*phantom, *real) for i in range(len(f.kinds)) if (f.ids == i + 1).sum() > 150]
        count = np.bincount([f.kinds[i - 1] for f, i in donors], minlength=len(CLASSES))
        real_count = max(1, sum(f.real for f, _ in donors))
        # Seldom kinds more often; guessed real outlines about as often as rendered ones.
        weight = np.array(
            [count[f.kinds[i - 1]] ** -0.5 * (0.5 / real_count if f.real else 0.5 / max(1, len(donors) - real_count)) for f, i in donors]
        )
        self.donors, self.donor_weights = donors, weight / weight.sum()

    def _paste(self, picture, ids, kinds, own, rng):
        f, number = self.donors[int(rng.choice(len(self.donors), p=self.donor_weights))]
        mask = (f.ids == number).astype(np.uint8)
        donor = f.picture
        if rng.random() < (0.5 if f.real else 0.85):
            donor = transfer_colour(donor, self.statistics[id(f)], own, rng.uniform(0.3, 0.9))
        # Instruments keep their entry: flips and a growth about the picture's middle leave the rim at or beyond the rim.
        h, w = mask.shape
        scale = rng.uniform(1.0, 1.5)
        turn = np.diag([scale * (-1 if rng.random() < 0.5 else 1), scale * (-1 if rng.random() < 0.25 else 1)])
        middle = np.array([w / 2, h / 2])
        matrix = np.hstack((turn, (middle - turn @ middle + rng.uniform(-0.08, 0.08, 2) * [w, h])[:, None])).astype(np.float32)
        donor = cv2.warpAffine(light(donor, rng) if rng.random() < 0.5 else donor, matrix, (w, h))
        mask = cv2.warpAffine(mask, matrix, (w, h), flags=cv2.INTER_NEAREST)
        if mask.sum() < 100 or len(kinds) >= 12:
            return picture, ids, kinds
        before = np.bincount(ids.ravel(), minlength=256)
        if ((ids > 0) & (mask > 0)).sum() > 0.5 * mask.sum():
            return picture, ids, kinds
        soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.5, 1.2))[..., None]
        picture = (picture * (1 - soft) + donor * soft).astype(np.uint8)
        ids = ids.copy()
        ids[mask > 0] = len(kinds) + 1
        after = np.bincount(ids.ravel(), minlength=256)
        # What is mostly hidden now is doubtful.
        for i in range(1, len(kinds) + 1):
            if before[i] and after[i] < 0.35 * before[i]:
                ids[ids == i] = DOUBT
        return picture, ids, [*kinds, f.kinds[number - 1]]

    def _round(self, picture, ids, rng):
        """The dark rim of an endoscope's round picture."""
        h, w = ids.shape
        inside = np.zeros((h, w), np.uint8)
        centre = (int(w * rng.uniform(0.42, 0.58)), int(h * rng.uniform(0.42, 0.58)))
        cv2.circle(inside, centre, int(w * rng.uniform(0.36, 0.55)), 1, -1)
        return picture * inside[..., None], ids * inside

    def sample(self, number, plain=False):
        rng = np.random.default_rng((self.seed, number))
        from_phantom = rng.random() < self.phantom_share
        source = self.phantom if from_phantom else self.real
        f = source[int(rng.integers(len(source)))]
        picture, ids, kinds = f.picture, f.ids, list(f.kinds)
        other = self.real_statistics[int(rng.integers(len(self.real_statistics)))]
        own = self.statistics[id(f)]
        if from_phantom and rng.random() < 0.8:
            picture, own = transfer_colour(picture, own, other, rng.uniform(0.5, 1.0)), other
        while rng.random() < (0.3 if from_phantom else 0.6):
            picture, ids, kinds = self._paste(picture, ids, kinds, own, rng)
        if from_phantom and rng.random() < 0.6:
            picture, ids = self._round(picture, ids, rng)
        h, w = ids.shape
        turn, grow = (4.0, (0.95, 1.1)) if plain else (20.0, (0.75, 1.5))
        scale, angle = np.exp(rng.uniform(*np.log(grow))), rng.uniform(-turn, turn)
        matrix = cv2.getRotationMatrix2D((w / 2, h / 2), angle, scale)
        if rng.random() < 0.5:
            matrix[0] = -matrix[0]
            matrix[0, 2] += w
        matrix[:, 2] += rng.uniform(-0.08, 0.08, 2) * [w, h]
        picture = cv2.warpAffine(picture, matrix, (w, h), borderValue=(0, 0, 0) if rng.random() < 0.5 else (114, 114, 114))
        ids = cv2.warpAffine(ids, matrix, (w, h), flags=cv2.INTER_NEAREST)
        picture = light(picture, rng) if plain else photometric(picture, rng, own, other)
        return picture, targets_of(ids, kinds)
