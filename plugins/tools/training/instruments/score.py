"""Average precision at IoU 0.5 (all-point interpolation), per class and mean, on letterboxed frames."""

import numpy as np
import torch

from .data import letterbox
from .yolox import STRIDES, decode, flatten, grid_of


def suppress(boxes, scores, iou_limit):
    """Greedy non-maximum suppression; boxes x0, y0, x1, y1."""
    order, keep = scores.argsort()[::-1], []
    area = (boxes[:, 2:] - boxes[:, :2]).prod(1)
    while len(order):
        i, rest = order[0], order[1:]
        keep.append(i)
        both = (np.minimum(boxes[i, 2:], boxes[rest, 2:]) - np.maximum(boxes[i, :2], boxes[rest, :2])).clip(0).prod(1)
        order = rest[both / (area[i] + area[rest] - both + 1e-9) <= iou_limit]
    return keep


def chosen(boxes, objectness, kinds, scale, score_limit, iou_limit):
    """Rows (class, score, x0, y0, x1, y1, objectness) of one picture from centre-size boxes in px of the input, class by class."""
    scores = objectness[:, None] * kinds
    corners = np.concatenate((boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2), 1) / scale
    rows = []
    for kind in range(scores.shape[1]):
        good = scores[:, kind] > score_limit
        b, s, o = corners[good], scores[good, kind], objectness[good]
        rows += [[kind, s[j], *b[j], o[j]] for j in suppress(b, s, iou_limit)]
    return np.array(rows, np.float32).reshape(-1, 7)


def rows_of(answer, width, height, scale, score_limit=0.01, iou_limit=0.65):
    """The same from one picture's N x (5 + C) answer of an exported file (probabilities, boxes relative to the grid)."""
    answer = torch.from_numpy(answer)
    grid, stride = grid_of([(height // s, width // s) for s in STRIDES])
    boxes = decode(answer[:, :4], grid, stride).numpy()
    return chosen(boxes, answer[:, 4].numpy(), answer[:, 5:].numpy(), scale, score_limit, iou_limit)


@torch.no_grad()
def detect(model, frames, width, height, score_limit=0.01, iou_limit=0.65, batch=16):
    """Per frame K x 7: class, score, x0, y0, x1, y1 in pixels of `frame.picture`, objectness."""
    model.eval()
    device = next(model.parameters()).device
    found = []
    for start in range(0, len(frames), batch):
        some = frames[start : start + batch]
        fitted = [letterbox(f.picture, f.boxes, width, height) for f in some]
        x = torch.from_numpy(np.stack([p for p, _, _ in fitted])).to(device).permute(0, 3, 1, 2).float()
        raw, grid, stride = flatten([level.float().cpu() for level in model(x)])
        boxes = decode(raw[..., :4], grid, stride).numpy()
        objectness, kinds = raw[..., 4].sigmoid().numpy(), raw[..., 5:].sigmoid().numpy()
        for i, (_, _, scale) in enumerate(fitted):
            found.append(chosen(boxes[i], objectness[i], kinds[i], scale, score_limit, iou_limit))
    return found


def average_precision(frames, found, classes, iou_limit=0.5):
    """AP of each class (NaN where the truth has none)."""
    result = []
    for kind in range(classes):
        truth = [f.boxes[f.boxes[:, 0] == kind][:, 1:] for f in frames]
        total = sum(map(len, truth))
        taken = [np.zeros(len(t), bool) for t in truth]
        rows = sorted(((r[1], i, r[2:6]) for i, rows in enumerate(found) for r in rows if r[0] == kind), key=lambda r: -r[0])
        hit = np.zeros(len(rows))
        for n, (_, i, box) in enumerate(rows):
            if len(truth[i]) == 0:
                continue
            both = (np.minimum(box[2:], truth[i][:, 2:]) - np.maximum(box[:2], truth[i][:, :2])).clip(0).prod(1)
            iou = both / ((box[2:] - box[:2]).prod() + (truth[i][:, 2:] - truth[i][:, :2]).prod(1) - both + 1e-9)
            best = int(iou.argmax())
            if iou[best] >= iou_limit and not taken[i][best]:
                taken[i][best] = True
                hit[n] = 1
        if total == 0:
            result.append(float("nan"))
            continue
        recall = np.cumsum(hit) / total
        precision = np.cumsum(hit) / np.arange(1, len(rows) + 1)
        envelope = np.maximum.accumulate(precision[::-1])[::-1]
        result.append(float(np.sum(np.diff(np.concatenate(([0.0], recall))) * envelope)))
    return result
