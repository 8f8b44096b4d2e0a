"""Frames without boxes, from folders of pictures and from videos, and what a teacher thinks of them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from .augment import erase, lab_statistics, photometric, warp
from .data import Frame

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff")
# Mean difference of two small gray pictures, of 255, below which the second shows nothing new.
SAME = 2.0
# Frames of one stretch of a recording, which go to the report together: neighbours look alike.
STRETCH = 20


def _small(picture):
    return cv2.resize(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), (32, 18), interpolation=cv2.INTER_AREA).astype(np.float32)


def _frame(name, group, path, picture, width):
    h, w = picture.shape[:2]
    wide = min(width, w)
    size = (wide, max(1, round(h * wide / w)))
    return Frame(name, group, path, (w, h), np.zeros((0, 5), np.float32), cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


def pictures_of(path, every_s=1.0):
    """Name, file and picture, in order; of a video one in `every_s` seconds."""
    path = Path(path)
    if path.is_dir():
        for file in sorted(f for f in path.rglob("*") if f.suffix.lower() in PICTURES):
            picture = cv2.imread(str(file))
            if picture is None:
                print(f"{file}: left out, it is no picture that can be read", flush=True)
                continue
            yield file.stem, file, picture
        return
    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        raise SystemExit(f"{path}: neither a folder of pictures nor a video that can be read")
    step, number = max(1, round((video.get(cv2.CAP_PROP_FPS) or 25.0) * every_s)), 0
    while video.grab():
        if number % step == 0:
            is_there, picture = video.retrieve()
            if is_there:
                yield f"{path.stem}_{number:06d}", path, picture
        number += 1


def read(paths, width, every_s=1.0, most=4000):
    """Frames of folders and videos, shrunk to `width`; one that looks like the one before is left out. Each path is an operation of its own."""
    frames = []
    for number, path in enumerate(paths):
        before = None
        for name, file, picture in pictures_of(path, every_s):
            small = _small(picture)
            if before is not None and np.abs(small - before).mean() < SAME:
                continue
            before = small
            frames.append(_frame(name, f"{Path(path).stem}#{number}", file, picture, width))
    if len(frames) > most:
        frames = [frames[i] for i in np.linspace(0, len(frames) - 1, most).astype(int)]
    return frames


def aside(frames, share):
    """Frames to adapt on and frames for the report: whole stretches, evenly taken, so that neighbours stand on one side."""
    every = max(2, round(1 / share))
    held = [i // STRETCH % every == every - 1 for i in range(len(frames))]
    if not any(held):
        # A short recording: its end.
        held = [i >= round(len(frames) * (1 - share)) for i in range(len(frames))]
    return [f for f, h in zip(frames, held) if not h], [f for f, h in zip(frames, held) if h]


@dataclass(frozen=True)
class Curve:
    """Probability of a score: 1 / (1 + exp(-(logit(score) / temperature + bias)))."""

    temperature: float = 1.0
    bias: float = 0.0

    def probability(self, score):
        score = np.clip(np.asarray(score, float), 1e-6, 1 - 1e-6)
        return 1 / (1 + np.exp(-(np.log(score / (1 - score)) / self.temperature + self.bias)))

    def score(self, probability):
        p = min(max(probability, 1e-6), 1 - 1e-6)
        return float(1 / (1 + np.exp(-(np.log(p / (1 - p)) - self.bias) * self.temperature)))


def detect(model, frames, width, height, curve, least=0.05, iou_limit=0.5, batch=8):
    """Per frame K x 7: class, probability, x0, y0, x1, y1 in pixels of `frame.picture`, objectness; one box per place, best first."""
    from . import score

    found = score.detect(model, frames, width, height, curve.score(least), iou_limit, batch)
    return [best_of_each_place(rows, curve, iou_limit) for rows in found]


def best_of_each_place(rows, curve, iou_limit):
    """The rows of one frame without those that overlap a better one, with probabilities for scores."""
    rows = rows[np.argsort(-rows[:, 1], kind="stable")]
    rows = rows[[k for k in range(len(rows)) if (overlaps(rows[k : k + 1], rows[:k]) <= iou_limit).all()]]
    rows[:, 1] = curve.probability(rows[:, 1])
    return rows


def overlaps(a, b):
    """IoU of each row of `a` with each of `b`, rows as of `detect`."""
    low = np.maximum(a[:, None, 2:4], b[None, :, 2:4])
    high = np.minimum(a[:, None, 4:6], b[None, :, 4:6])
    both = (high - low).clip(0).prod(2)
    area = lambda r: (r[:, 4:6] - r[:, 2:4]).prod(1)
    return both / (area(a)[:, None] + area(b)[None] - both + 1e-9)


def pseudo(rows, sure, unsure):
    """Boxes to learn (K x 5: class, corners) and boxes to hide (K x 4): what the teacher is sure of, and what it half believes."""
    learn = rows[rows[:, 1] >= sure]
    hide = rows[(rows[:, 1] < sure) & (rows[:, 1] >= unsure)]
    if len(learn) and len(hide):
        # A half-believed box on a sure one is the same tool.
        hide = hide[(overlaps(hide, learn) < 0.3).all(1)]
    return np.concatenate((learn[:, :1], learn[:, 2:6]), 1).astype(np.float32), hide[:, 2:6].astype(np.float32)


def covered(picture, hidden, learned):
    """The picture with `hidden` boxes in its mean colour: a student must not learn that nothing is there. Learned boxes stay in view."""
    if len(hidden) == 0:
        return picture
    h, w = picture.shape[:2]
    out, plain = picture.copy(), picture.reshape(-1, 3).mean(0)
    whole = lambda b: (slice(int(max(0, b[1])), int(min(h, np.ceil(b[3])))), slice(int(max(0, b[0])), int(min(w, np.ceil(b[2])))))
    for box in hidden:
        out[whole(box)] = plain
    for box in learned:
        out[whole(box[1:])] = picture[whole(box[1:])]
    return out


def strong(frame, boxes, hidden, other, width, height, rng, changes):
    """The student's view: width x height BGR with boxes as class, cx, cy, w, h. `other`: colour statistics of another frame."""
    picture = covered(frame.picture, hidden, boxes)
    picture = photometric(picture.copy(), rng, lab_statistics(frame.picture), other, changes - {"erase"})
    picture, boxes = warp(picture, boxes, width, height, rng, (0.75, 1.35), 10.0, 0.1)
    if "erase" in changes and rng.random() < 0.3:
        picture = erase(picture, rng)
    out = boxes.copy()
    out[:, 1:3] = (boxes[:, 1:3] + boxes[:, 3:]) / 2
    out[:, 3:] = boxes[:, 3:] - boxes[:, 1:3]
    return picture, out
