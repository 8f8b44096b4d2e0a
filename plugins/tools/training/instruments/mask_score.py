"""Mask average precision at an overlap of 0.5, with doubtful regions left out."""

import cv2
import numpy as np
import torch

from .outlines import DOUBT, targets_of


def pasted(maps, boxes, height, width, threshold=0.5):
    """K x 1 x M x M certainties as K full-size masks: values stand at the centres of a grid over the box, as the `mask_rcnn` node reads them."""
    out = np.zeros((len(maps), height, width), bool)
    y, x = np.mgrid[:height, :width].astype(np.float32) + 0.5
    for i, (m, b) in enumerate(zip(maps, boxes)):
        side = m.shape[-1]
        u = (x - b[0]) / max(b[2] - b[0], 1e-3) * side - 0.5
        v = (y - b[1]) / max(b[3] - b[1], 1e-3) * side - 0.5
        value = cv2.remap(np.ascontiguousarray(m[0]), u, v, cv2.INTER_LINEAR, borderValue=0)
        out[i] = (value >= threshold) & (x >= b[0]) & (x <= b[2]) & (y >= b[1]) & (y <= b[3])
    return out


@torch.no_grad()
def mask_ap50(model, frames, classes, score_limit=0.05):
    """AP of each class (NaN where the truth has none). A find that lies mostly in doubt counts neither way."""
    model.eval()
    rows = [[] for _ in range(classes)]
    totals = np.zeros(classes, int)
    for f in frames:
        x = torch.from_numpy(f.picture).permute(2, 0, 1)[None].float()
        found = {k: v.numpy() for k, v in model(x)[0].items()}
        truth = targets_of(f.ids, f.kinds)
        for label in truth["labels"]:
            totals[label - 1] += 1
        masks = pasted(found["masks"], found["boxes"], *f.ids.shape)
        taken = set()
        for n in np.argsort(-found["scores"]):
            if found["scores"][n] < score_limit or not masks[n].any():
                continue
            label, best, which = int(found["labels"][n]), 0.0, -1
            for t, mask in enumerate(truth["masks"]):
                if truth["labels"][t] == label and t not in taken:
                    iou = (masks[n] & (mask > 0)).sum() / (masks[n] | (mask > 0)).sum()
                    if iou > best:
                        best, which = iou, t
            hit = best >= 0.5
            if hit:
                taken.add(which)
            elif (f.ids[masks[n]] == DOUBT).mean() > 0.4:
                continue
            rows[label - 1].append((found["scores"][n], hit))
    result = []
    for kind in range(classes):
        if totals[kind] == 0:
            result.append(float("nan"))
            continue
        hits = np.array([h for _, h in sorted(rows[kind], key=lambda r: -r[0])], float)
        recall, precision = np.cumsum(hits) / totals[kind], np.cumsum(hits) / np.arange(1, len(hits) + 1)
        envelope = np.maximum.accumulate(precision[::-1])[::-1]
        result.append(float(np.sum(np.diff(np.concatenate(([0.0], recall))) * envelope)))
    return np.array(result)
