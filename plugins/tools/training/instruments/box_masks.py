"""Masks from boxes: a guess at a whole instrument's outline where only its working end is boxed, with a doubt when it is no good guess.

Metal and plastic are less red than tissue. Inside the box and along the one corridor from it to the rim of the lit picture that looks most like
a shaft, pixels are told apart by the a* channel (Otsu 1979) and the edge is settled by GrabCut (Rother et al. 2004). What does not separate
well is doubtful: training then looks away from it instead of learning a wrong outline.
"""

import cv2
import numpy as np

DIRECTIONS = 48


def lit(picture):
    """Where the endoscope's round picture is."""
    bright = (picture.max(2) > 24).astype(np.uint8)
    return cv2.morphologyEx(bright, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)) > 0


def separation(values):
    """Otsu's threshold of u8 values and the share of their variance that it explains."""
    if len(values) < 50:
        return 0, 0.0
    limit, _ = cv2.threshold(values.reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    low = values <= limit
    share = low.mean()
    if share in (0.0, 1.0) or values.std() < 1e-3:
        return limit, 0.0
    between = share * (1 - share) * (float(values[low].mean()) - float(values[~low].mean())) ** 2
    return limit, between / float(values.var())


def corridor(shape, centre, angle, half_width, reach):
    out = np.zeros(shape, np.uint8)
    end = centre + reach * np.array([np.cos(angle), np.sin(angle)])
    side = half_width * np.array([-np.sin(angle), np.cos(angle)])
    corners = np.array([centre - side, centre + side, end + 1.4 * side, end - 1.4 * side])
    cv2.fillConvexPoly(out, np.round(corners).astype(np.int32), 1)
    return out > 0


def shaft(a, light, box, limit):
    """The corridor from the box to the rim that holds the most metal compared with the strips beside it; None where there is none."""
    x0, y0, x1, y1 = box
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    half = max(4.0, 0.22 * min(x1 - x0, y1 - y0))
    reach = float(np.hypot(*a.shape))
    inside = np.zeros(a.shape, bool)
    inside[int(y0) : int(y1), int(x0) : int(x1)] = True
    best = (0.35, None)
    metal = a <= limit
    for i in range(DIRECTIONS):
        angle = 2 * np.pi * i / DIRECTIONS
        core = corridor(a.shape, centre, angle, half, reach) & light & ~inside
        if core.sum() < 40:
            continue
        beside = corridor(a.shape, centre, angle, 3 * half, reach) & light & ~inside & ~core
        # Metal all the way to the rim: the worst third counts as well as the mean.
        ys, xs = core.nonzero()
        along = (xs - centre[0]) * np.cos(angle) + (ys - centre[1]) * np.sin(angle)
        thirds = [metal[ys, xs][part].mean() for part in np.array_split(np.argsort(along), 3) if len(part)]
        score = min(thirds) + float(np.mean(thirds)) - (metal[beside].mean() if beside.any() else 0.0) - 0.5
        if score > best[0]:
            best = (score, corridor(a.shape, centre, angle, 3.0 * half, reach) & light)
    return best[1]


def masks_of(picture, boxes):
    """Per box (class, x0, y0, x1, y1): the mask, or None with doubt; and the region in which it would lie."""
    a = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)[..., 1], (0, 0), 1.0)
    light = lit(picture)
    h, w = a.shape
    found = []
    regions = []
    for _, x0, y0, x1, y1 in boxes:
        region = np.zeros((h, w), bool)
        mx, my = 0.25 * (x1 - x0) + 4, 0.25 * (y1 - y0) + 4
        around = np.s_[max(0, int(y0 - my)) : int(y1 + my), max(0, int(x0 - mx)) : int(x1 + mx)]
        limit, explained = separation(a[around][light[around]])
        region[max(0, int(y0) - 2) : int(y1) + 3, max(0, int(x0) - 2) : int(x1) + 3] = True
        way = shaft(a, light, (x0, y0, x1, y1), limit) if explained > 0.45 else None
        if way is not None:
            region |= way
        regions.append((region, limit, explained, way is not None))
    for n, (box, (region, limit, explained, has_way)) in enumerate(zip(boxes, regions)):
        _, x0, y0, x1, y1 = box
        others = np.zeros((h, w), bool)
        for j, (_, u0, v0, u1, v1) in enumerate(boxes):
            if j != n:
                others[int(v0) : int(v1), int(u0) : int(u1)] = True
        box_area = max(1.0, (x1 - x0) * (y1 - y0))
        at_rim = x0 < 3 or y0 < 3 or x1 > w - 4 or y1 > h - 4
        if explained < 0.6 or not (has_way or at_rim):
            found.append((None, region))
            continue
        seed = np.where(region & light, np.where(a <= limit, cv2.GC_PR_FGD, cv2.GC_PR_BGD), cv2.GC_BGD).astype(np.uint8)
        seed[others] = cv2.GC_BGD
        if (seed == cv2.GC_PR_FGD).sum() < 50:
            found.append((None, region))
            continue
        cv2.grabCut(picture, seed, None, np.zeros((1, 65)), np.zeros((1, 65)), 2, cv2.GC_INIT_WITH_MASK)
        metal = ((seed == cv2.GC_PR_FGD) | (seed == cv2.GC_FGD)).astype(np.uint8)
        metal = cv2.morphologyEx(metal, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        count, labels = cv2.connectedComponents(metal)
        part = np.bincount(labels[int(y0) : int(y1) + 1, int(x0) : int(x1) + 1].ravel(), minlength=count)
        part[0] = 0
        mask = labels == part.argmax() if part.any() else np.zeros((h, w), bool)
        filled = part.max() / box_area
        # The working end spans its box: a guess that reaches only a corner of it is another thing.
        ys, xs = mask[int(y0) : int(y1) + 1, int(x0) : int(x1) + 1].nonzero()
        span = 0.0 if len(xs) == 0 else min((np.ptp(xs) + 1) / (x1 - x0 + 1), (np.ptp(ys) + 1) / (y1 - y0 + 1))
        good = 0.15 < filled < 0.9 and span > 0.6 and mask.sum() < 0.3 * h * w
        found.append((mask if good else None, region))
    return found
