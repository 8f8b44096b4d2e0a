"""Augmentation that makes one operation look like another: light, colour, smoke, blur, position, size and company."""

from functools import partial

import cv2
import numpy as np


def lab_statistics(picture):
    """Mean and deviation of L, a, b over the lit part of a picture."""
    lab = cv2.cvtColor(picture[::4, ::4], cv2.COLOR_BGR2LAB).astype(np.float32).reshape(-1, 3)
    lit = lab[lab[:, 0] > 25]
    lab = lit if len(lit) > 50 else lab
    return lab.mean(0), lab.std(0) + 1e-3


def transfer_colour(picture, own, other, share):
    """Moves a picture's colour statistics towards those of another operation (Reinhard et al. 2001), by a table per L, a, b."""
    gain = np.clip(other[1] / own[1], 0.5, 2.0)
    level = np.arange(256, dtype=np.float32)[:, None]
    tables = level + share * ((level - own[0]) * gain + other[0] - level)
    tables = np.clip(tables, 0, 255).astype(np.uint8).reshape(256, 1, 3)
    return cv2.cvtColor(cv2.LUT(cv2.cvtColor(picture, cv2.COLOR_BGR2LAB), tables), cv2.COLOR_LAB2BGR)


def lookup(picture, curves):
    """Sends each channel through its curve, 256 x 3 values in 0..255."""
    return cv2.LUT(picture, np.clip(curves, 0, 255).astype(np.uint8).reshape(256, 1, 3))


def light(picture, rng):
    """Gamma, gain per channel, contrast, saturation."""
    ramp = np.arange(256, dtype=np.float32)[:, None] / 255
    gamma = np.exp(rng.uniform(-0.5, 0.5))
    gains = np.exp(rng.uniform(-0.35, 0.35)) * np.exp(rng.uniform(-0.12, 0.12, 3))
    picture = lookup(picture, (ramp**gamma) * gains * 255)
    if rng.random() < 0.5:
        gray = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        share = rng.uniform(0.3, 1.6)
        picture = cv2.addWeighted(picture, share, gray, 1 - share, 0)
    return picture


def white_balance(picture, rng):
    """Another white: gains of blue against red and of green against both, and a gamma of each channel's own."""
    warm, green = rng.uniform(-0.35, 0.35), rng.uniform(-0.2, 0.2)
    gains = np.exp(np.array([warm, green, -warm], np.float32))
    ramp = np.arange(256, dtype=np.float32)[:, None] / 255
    return lookup(picture, ramp ** np.exp(rng.uniform(-0.25, 0.25, 3)) * gains / gains.mean() * 255)


def cloud(shape, rng, cells=4):
    """Smooth noise in 0..1."""
    h, w = shape[:2]
    return cv2.resize(rng.random((cells, cells + 2)).astype(np.float32), (w, h), interpolation=cv2.INTER_CUBIC).clip(0, 1)


def weigh(picture, weight, base=None, colour=(1.0, 1.0, 1.0)):
    """picture * weight + base * colour, per pixel; the answer in bytes."""
    weighed = cv2.multiply(picture, cv2.merge((weight, weight, weight)), dtype=cv2.CV_8U if base is None else cv2.CV_32F)
    return weighed if base is None else cv2.add(weighed, cv2.merge([base * np.float32(c) for c in colour]), dtype=cv2.CV_8U)


def smoke(picture, rng):
    veil = cloud(picture.shape, rng) * np.float32(rng.uniform(0.2, 0.7))
    return weigh(picture, 1 - veil, veil * np.float32(rng.uniform(150, 230)))


def vignette(picture, rng):
    """Fall-off of the light from a random centre."""
    h, w = picture.shape[:2]
    cx, cy = rng.uniform(0.25, 0.75) * w, rng.uniform(0.25, 0.75) * h
    dx = (np.arange(w, dtype=np.float32) - cx) ** 2
    dy = (np.arange(h, dtype=np.float32) - cy) ** 2
    fall = 1 - np.float32(rng.uniform(0.2, 0.7)) * np.minimum((dx[None] + dy[:, None]) / np.float32((0.5 * w) ** 2), 1)
    return weigh(picture, fall.astype(np.float32))


def lit(picture):
    """Where light falls, 0..1: nothing is seen to bleed or shine in the black around a round picture."""
    brightest = cv2.max(cv2.max(*cv2.split(picture)[:2]), cv2.extractChannel(picture, 2))
    return cv2.min(cv2.multiply(cv2.GaussianBlur(brightest, (0, 0), 3), 1 / 40, dtype=cv2.CV_32F), 1)


def blood(picture, rng):
    """Dark red patches with soft rims, some of them nearly opaque: tissue that bleeds, drops on the lens."""
    field = cloud(picture.shape, rng, cells=int(rng.integers(4, 10)))
    level = np.float32(rng.uniform(0.55, 0.8))
    cover = ((field - level) / np.float32(0.15)).clip(0, 1) * np.float32(rng.uniform(0.4, 0.95)) * lit(picture)
    red = (rng.uniform(5, 40), rng.uniform(5, 35), rng.uniform(70, 170))
    return weigh(picture, 1 - cover, cover, red)


def highlight(picture, rng):
    """A few saturated spots with a glow around them, as wet tissue and steel reflect the light."""
    h, w = picture.shape[:2]
    glow = np.zeros((h, w), np.float32)
    for _ in range(int(rng.integers(2, 9))):
        axes = (max(1, int(rng.uniform(0.003, 0.03) * w)), max(1, int(rng.uniform(0.003, 0.02) * w)))
        cv2.ellipse(glow, (int(rng.integers(0, w)), int(rng.integers(0, h))), axes, rng.uniform(0, 180), 0, 360, 1.0, -1)
    glow = np.minimum(glow + cv2.GaussianBlur(glow, (0, 0), 0.012 * w), 1) * np.float32(rng.uniform(0.6, 1)) * lit(picture)
    return weigh(picture, 1 - glow, glow * np.float32(250))


def blur(picture, rng):
    if rng.random() < 0.5:
        return cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.5, 1.8))
    length = int(rng.integers(3, 10))
    kernel = np.zeros((length, length), np.float32)
    angle = rng.uniform(0, np.pi)
    c = (length - 1) / 2
    for t in np.linspace(-c, c, 2 * length):
        kernel[int(round(c + t * np.sin(angle))), int(round(c + t * np.cos(angle)))] = 1
    return cv2.filter2D(picture, -1, kernel / kernel.sum())


def noise(picture, rng):
    cv2.setRNGSeed(int(rng.integers(1 << 31)))
    grain = np.empty(picture.shape, np.int16)
    cv2.randn(grain, 0, rng.uniform(2, 10))
    return cv2.add(picture, grain, dtype=cv2.CV_8U)


def compress(picture, rng):
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 80))])
    return cv2.imdecode(data, cv2.IMREAD_COLOR) if ok else picture


def erase(picture, rng):
    """Covers a few patches, as blood or another instrument would."""
    h, w = picture.shape[:2]
    for _ in range(int(rng.integers(1, 4))):
        ph, pw = int(rng.uniform(0.05, 0.2) * h), int(rng.uniform(0.05, 0.2) * w)
        y, x = int(rng.integers(0, h - ph)), int(rng.integers(0, w - pw))
        picture[y : y + ph, x : x + pw] = rng.integers(0, 255, 3)
    return picture


# Changes of light and picture, in the order in which they are applied, with the share of the samples that each changes.
CHANGES = {
    "light": (light, 0.8),
    "white_balance": (white_balance, 0.4),
    "vignette": (vignette, 0.15),
    "blood": (blood, 0.15),
    "smoke": (smoke, 0.2),
    "highlight": (highlight, 0.15),
    "blur": (blur, 0.2),
    "noise": (noise, 0.15),
    "jpeg": (compress, 0.1),
    "erase": (erase, 0.2),
}
COLOUR_SHARE = 0.5
NAMES = ("colour", *CHANGES)
# Those that the detectors of earlier versions learned with; the one that ships learned with all.
USUAL = frozenset(NAMES) - {"white_balance", "blood", "highlight"}


def chosen_changes(text):
    """Names of changes from a list such as `usual,blood,-smoke`: `all`, `usual`, `none`, names, and names after a minus, from left to right."""
    sets, names = {"all": frozenset(NAMES), "usual": USUAL, "none": frozenset()}, set()
    for word in filter(None, (part.strip() for part in text.split(","))):
        name = word.removeprefix("-")
        if name not in sets and name not in NAMES:
            raise ValueError(f"there is no change `{name}`; there are {', '.join((*sets, *NAMES))}")
        one = sets.get(name, {name})
        names = names - one if word.startswith("-") else names | one
    return frozenset(names)


def photometric(picture, rng, own, other, changes=USUAL):
    """Changes a picture by some of `changes`; `own` and `other` are colour statistics, of it and of another frame."""
    if "colour" in changes and rng.random() < COLOUR_SHARE:
        picture = transfer_colour(picture, own, other, rng.uniform(0.4, 1.0))
    for name, (change, share) in CHANGES.items():
        if name in changes and rng.random() < share:
            picture = change(picture, rng)
    return picture


def warp(picture, boxes, width, height, rng, scale_range, turn_deg=15.0, shift=0.15, origin=None):
    """Random similarity with shear and flips into width x height; boxes that leave the picture go."""
    h, w = picture.shape[:2]
    fit = min(width / w, height / h)
    scale = fit * np.exp(rng.uniform(*np.log(scale_range)))
    angle = np.deg2rad(rng.uniform(-turn_deg, turn_deg))
    shear = rng.uniform(-0.08, 0.08, 2)
    flip = np.diag([-1.0 if rng.random() < 0.5 else 1.0, -1.0 if rng.random() < 0.15 else 1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = scale * turn @ np.array([[1, shear[0]], [shear[1], 1]]) @ flip
    target = np.array([width, height]) * (0.5 + rng.uniform(-shift, shift, 2)) if origin is None else origin
    offset = target - linear @ np.array([w / 2, h / 2])
    matrix = np.hstack((linear, offset[:, None])).astype(np.float32)
    out = cv2.warpAffine(picture, matrix, (width, height), flags=cv2.INTER_LINEAR, borderValue=(114, 114, 114))
    return out, move_boxes(boxes, matrix, width, height)


def move_boxes(boxes, matrix, width, height):
    if len(boxes) == 0:
        return boxes
    x0, y0, x1, y1 = boxes[:, 1], boxes[:, 2], boxes[:, 3], boxes[:, 4]
    # The box of an ellipse, not of the corners: a turned corner box grows where there is no tool.
    cx, cy, a, b = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    mx = matrix[0, 0] * cx + matrix[0, 1] * cy + matrix[0, 2]
    my = matrix[1, 0] * cx + matrix[1, 1] * cy + matrix[1, 2]
    half_x = np.sqrt((matrix[0, 0] * a) ** 2 + (matrix[0, 1] * b) ** 2)
    half_y = np.sqrt((matrix[1, 0] * a) ** 2 + (matrix[1, 1] * b) ** 2)
    moved = np.stack((boxes[:, 0], mx - half_x, my - half_y, mx + half_x, my + half_y), 1)
    area = (2 * half_x) * (2 * half_y)
    moved[:, [1, 3]] = moved[:, [1, 3]].clip(0, width)
    moved[:, [2, 4]] = moved[:, [2, 4]].clip(0, height)
    left = (moved[:, 3] - moved[:, 1]) * (moved[:, 4] - moved[:, 2])
    keep = (left > 0.35 * area) & (moved[:, 3] - moved[:, 1] > 4) & (moved[:, 4] - moved[:, 2] > 4)
    return moved[keep].astype(np.float32)


def paste(picture, boxes, donor, donor_box, rng, recolour=None):
    """Sets the working end of another frame's tool into this picture, softly, where it covers little of other tools.

    `recolour` changes the piece that is taken, before it is set in."""
    k, x0, y0, x1, y1 = donor_box
    mx, my = 0.12 * (x1 - x0) + 2, 0.12 * (y1 - y0) + 2
    h, w = donor.shape[:2]
    cx0, cy0, cx1, cy1 = int(max(0, x0 - mx)), int(max(0, y0 - my)), int(min(w, x1 + mx)), int(min(h, y1 + my))
    crop = donor[cy0:cy1, cx0:cx1]
    crop = recolour(crop) if recolour else crop
    box = np.array([x0 - cx0, y0 - cy0, x1 - cx0, y1 - cy0])
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
        box = np.array([crop.shape[1] - box[2], box[1], crop.shape[1] - box[0], box[3]])
    scale = rng.uniform(0.7, 1.4)
    crop = cv2.resize(np.ascontiguousarray(crop), None, fx=scale, fy=scale)
    box = box * scale
    ch, cw = crop.shape[:2]
    H, W = picture.shape[:2]
    if ch >= H or cw >= W or ch < 8 or cw < 8:
        return boxes
    for _ in range(8):
        x, y = int(rng.integers(0, W - cw)), int(rng.integers(0, H - ch))
        placed = np.array([box[0] + x, box[1] + y, box[2] + x, box[3] + y])
        if len(boxes):
            over = (np.minimum(boxes[:, 3:], placed[2:]) - np.maximum(boxes[:, 1:3], placed[:2])).clip(0).prod(1)
            if (over > 0.1 * (boxes[:, 3:] - boxes[:, 1:3]).prod(1)).any():
                continue
        yy, xx = np.mgrid[:ch, :cw].astype(np.float32)
        radius = np.maximum(np.abs(xx / cw - 0.5), np.abs(yy / ch - 0.5)) * 2
        mask = np.clip((1 - radius) / 0.2, 0, 1)[..., None]
        spot = picture[y : y + ch, x : x + cw]
        picture[y : y + ch, x : x + cw] = (spot * (1 - mask) + crop * mask).astype(np.uint8)
        return np.vstack((boxes, np.concatenate(([k], placed))[None])).astype(np.float32)
    return boxes


def shared_out(weights, guest, share):
    """Weights that sum to 1, of which those of guests sum to `share`."""
    weights = np.asarray(weights, float)
    if guest.any():
        weights[guest] *= share / weights[guest].sum()
        weights[~guest] *= (1 - share) / weights[~guest].sum()
    return weights / weights.sum()


class Augmented:
    """Endless, seeded samples: width x height BGR pictures with boxes as class, cx, cy, w, h.

    `changes`: names of CHANGES. With `per_operation` a class is balanced in each operation for itself, so that one seen often in one operation
    and seldom in another comes up in both. The last `guests` of the frames are of another kind (rendered ones); together they make `guests_share` of the samples and of the pasted tools."""

    def __init__(
        self, frames, width, height, seed, mosaic=0.4, pasting=0.35, balance=0.5, guests=0, guests_share=0.0, changes=USUAL, per_operation=False
    ):
        self.frames, self.width, self.height, self.seed = frames, width, height, seed
        self.mosaic, self.pasting, self.changes = mosaic, pasting, changes
        self.statistics = [lab_statistics(f.picture) for f in frames]
        groups = {g: i for i, g in enumerate(sorted({f.group for f in frames}))}
        per_group = np.bincount([groups[f.group] for f in frames], minlength=len(groups))
        per_class = np.bincount(np.concatenate([f.boxes[:, 0].astype(int) for f in frames]), minlength=8)
        # Boxes of a class as the balancing counts them: in all frames, or in each operation for itself.
        counts = np.zeros((len(groups), len(per_class)))
        for f in frames:
            np.add.at(counts[groups[f.group]], f.boxes[:, 0].astype(int), 1)
        counts = counts * len(groups) if per_operation else np.broadcast_to(per_class, counts.shape)
        # Seldom tools and small operations come up more often (square-root balancing).
        weights = []
        for f in frames:
            kinds, group = f.boxes[:, 0].astype(int), groups[f.group]
            rare = max((1.0 / counts[group, k] for k in kinds), default=1.0 / counts[group].max())
            weights.append((rare**balance) * (1.0 / per_group[group]) ** (balance / 2))
        hosts = len(frames) - guests
        guest = np.arange(len(frames)) >= hosts
        self.weights = shared_out(np.array(weights), guest, guests_share)
        self.plain_weights = shared_out(np.ones(len(frames)), guest, guests_share)
        tools = [(i, j) for i, f in enumerate(frames) for j in range(len(f.boxes))]
        rare = np.array([1.0 / per_class[int(frames[i].boxes[j, 0])] for i, j in tools]) ** 0.7
        self.tools = tools
        self.tool_weights = shared_out(rare, np.array([i >= hosts for i, _ in tools]), guests_share)

    def _one(self, rng):
        """A frame with pasted tools, its boxes, and the change of light and picture that it gets."""
        i = int(rng.choice(len(self.frames), p=self.weights))
        f = self.frames[i]
        other = self.statistics[int(rng.choice(len(self.frames), p=self.weights))]
        picture, boxes = f.picture.copy(), f.boxes
        while rng.random() < self.pasting:
            d, b = self.tools[int(rng.choice(len(self.tools), p=self.tool_weights))]
            donor = self.frames[d].picture
            recolour = None
            if rng.random() < 0.6:
                recolour = partial(transfer_colour, own=self.statistics[d], other=self.statistics[i], share=0.7)
            boxes = paste(picture, boxes, donor, self.frames[d].boxes[b], rng, recolour)
        return picture, boxes, partial(photometric, rng=rng, own=self.statistics[i], other=other, changes=self.changes)

    def sample(self, number, plain=False):
        rng = np.random.default_rng((self.seed, number))
        w, h = self.width, self.height
        if plain:
            # The closing epochs: whole frames with mild light changes only, each as often as the next.
            f = self.frames[int(rng.choice(len(self.frames), p=self.plain_weights))]
            picture = light(f.picture, rng) if rng.random() < 0.5 else f.picture
            picture, boxes = warp(picture, f.boxes, w, h, rng, (0.9, 1.15), 4.0, 0.04)
        elif rng.random() < self.mosaic:
            cut = np.array([w * rng.uniform(0.35, 0.65), h * rng.uniform(0.35, 0.65)]).astype(int)
            picture, rows = np.full((h, w, 3), 114, np.uint8), []
            spans = [(0, cut[0], 0, cut[1]), (cut[0], w, 0, cut[1]), (0, cut[0], cut[1], h), (cut[0], w, cut[1], h)]
            for x0, x1, y0, y1 in spans:
                part, boxes, change = self._one(rng)
                tw, th = int(x1 - x0), int(y1 - y0)
                part, boxes = warp(part, boxes, tw, th, rng, (1.0, 2.2))
                # Changed once it is cut to its part: a quarter of the pixels.
                picture[y0:y1, x0:x1] = change(part)
                rows.append(boxes + np.array([0, x0, y0, x0, y0], np.float32))
            boxes = np.vstack(rows)
        else:
            picture, boxes, change = self._one(rng)
            picture, boxes = warp(change(picture), boxes, w, h, rng, (0.65, 1.7))
        out = boxes.copy()
        out[:, 1:3] = (boxes[:, 1:3] + boxes[:, 3:]) / 2
        out[:, 3:] = boxes[:, 3:] - boxes[:, 1:3]
        return picture, out
