"""What an adaptation changed: classes, agreement, scores, a contact sheet, and whether it went too far. Needs NumPy and OpenCV."""

import cv2
import numpy as np

from .unlabelled import overlaps

# Probability from which a box is reported: the default of the `yolo` node.
REPORTED = 0.3
# From when on a change is too large to trust unseen: share of boxes that stay, number of boxes of a class against before, mean score against before.
LEAST_AGREEMENT, MOST_FACTOR, FEW, MOST_SHIFT = 0.6, 2.0, 10, 0.2


def compare(before, after):
    """How the boxes of two rounds meet: alike, of another class, only before, only after; per frame and in all."""
    rows = []
    for old, new in zip(before, after):
        old, new = old[old[:, 1] >= REPORTED], new[new[:, 1] >= REPORTED]
        both = overlaps(old, new)
        alike = renamed = 0
        taken = set()
        for i in np.argsort(-old[:, 1], kind="stable"):
            free = [j for j in range(len(new)) if j not in taken and both[i, j] >= 0.5]
            if free:
                j = max(free, key=lambda j: (new[j, 0] == old[i, 0], both[i, j]))
                taken.add(j)
                alike, renamed = alike + (new[j, 0] == old[i, 0]), renamed + (new[j, 0] != old[i, 0])
        rows.append([int(alike), int(renamed), len(old) - len(taken), len(new) - len(taken)])
    return np.array(rows, int).reshape(-1, 4)


def summary(before, after, classes):
    """Numbers of the report, ready for JSON."""
    rows = compare(before, after)
    alike, renamed, gone, new = (int(v) for v in rows.sum(0))
    every = alike + renamed + gone + new
    scores = [np.concatenate([r[:, 1] for r in found] or [np.zeros(0)]) for found in (before, after)]
    per_class = lambda found: [int(sum((r[r[:, 1] >= REPORTED][:, 0] == k).sum() for r in found)) for k in range(len(classes))]
    mean = lambda s: float(s[s >= REPORTED].mean()) if (s >= REPORTED).any() else None
    return {
        "frames": len(before),
        "classes": {name: {"before": b, "after": a} for name, b, a in zip(classes, per_class(before), per_class(after))},
        "boxes": {"alike": alike, "renamed": renamed, "only_before": gone, "only_after": new},
        "agreement": alike / every if every else 1.0,
        "mean_score": {"before": mean(scores[0]), "after": mean(scores[1])},
        "histogram": {name: np.histogram(s, 10, (0, 1))[0].tolist() for name, s in zip(("before", "after"), scores)},
    }


def warnings(report, source=None):
    """Why the adapted detector should not be used before somebody has looked at it. `source`: mAP on labelled frames, before and after."""
    found = []
    if report["agreement"] < LEAST_AGREEMENT:
        found.append(f"only {100 * report['agreement']:.0f} % of the boxes stayed as they were (at least {100 * LEAST_AGREEMENT:.0f} % are usual)")
    for name, count in report["classes"].items():
        low, high = sorted((count["before"], count["after"]))
        if high >= FEW and high > MOST_FACTOR * max(low, 1):
            found.append(f"{name}: {count['before']} boxes before, {count['after']} after")
    old, new = report["mean_score"]["before"], report["mean_score"]["after"]
    if old is not None and new is not None and abs(new - old) > MOST_SHIFT:
        found.append(f"the mean score went from {old:.2f} to {new:.2f}")
    if old is not None and new is None:
        found.append("nothing is found any more")
    if source and source["before"] - source["after"] > 0.05:
        found.append(f"it forgot: mAP50 on the labelled frames went from {source['before']:.3f} to {source['after']:.3f}")
    return found


def sheet(path, frames, before, after, classes, most=24, columns=4, cell=(400, 260)):
    """The frames that changed most: boxes before in red, after in green."""
    rows = compare(before, after)
    changed = [int(i) for i in np.argsort(-rows[:, 1:].sum(1), kind="stable")[:most] if rows[i, 1:].sum()]
    height = cell[1] * max(1, -(-len(changed) // columns))
    out = np.full((height, cell[0] * columns, 3), 24, np.uint8)
    write = lambda text, at, color, size=0.45: cv2.putText(out, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
    if not changed:
        write("no frame changed", (20, 40), (255, 255, 255), 0.8)
    for place, index in enumerate(changed):
        x0, y0 = place % columns * cell[0], place // columns * cell[1]
        picture = frames[index].picture
        h, w = picture.shape[:2]
        scale = min((cell[0] - 4) / w, (cell[1] - 40) / h)
        size = (int(w * scale), int(h * scale))
        out[y0 + 38 : y0 + 38 + size[1], x0 + 2 : x0 + 2 + size[0]] = cv2.resize(picture, size)
        words = {}
        for found, color, shift in ((before[index], (60, 60, 255), 0), (after[index], (60, 220, 60), 2)):
            shown = found[found[:, 1] >= REPORTED]
            for row in shown:
                a, b = (row[2:4] * scale).astype(int) + shift, (row[4:6] * scale).astype(int) - shift
                cv2.rectangle(out, (x0 + 2 + a[0], y0 + 38 + a[1]), (x0 + 2 + b[0], y0 + 38 + b[1]), color, 2)
            words[color] = ", ".join(f"{classes[int(r[0])]} {r[1]:.2f}" for r in shown) or "nothing"
        for line, (color, text) in enumerate(words.items()):
            write(text[:52], (x0 + 4, y0 + 14 + 17 * line), color)
    cv2.imwrite(str(path), out)
    return len(changed)


def text(report, warned, source, settings):
    """The report as Markdown."""
    lines = ["# Adaptation without labels", ""]
    lines += [f"Compared on {report['frames']} frames that it did not learn from; boxes of {REPORTED} and more.", ""]
    if warned:
        lines += ["**Look at `changes.png` before you use this detector:**", "", *(f"- {w}" for w in warned), ""]
    else:
        lines += ["No sign that it went too far. Look at `changes.png` all the same.", ""]
    lines += ["| class | before | after |", "|---|---|---|"]
    lines += [f"| {name} | {count['before']} | {count['after']} |" for name, count in report["classes"].items()]
    b = report["boxes"]
    lines += ["", f"Boxes alike {b['alike']}, renamed {b['renamed']}, only before {b['only_before']}, only after {b['only_after']}: agreement {100 * report['agreement']:.0f} %."]
    lines += ["", "| score | " + " | ".join(f"{k / 10:.1f}" for k in range(10)) + " |", "|---" * 11 + "|"]
    lines += [f"| {name} | " + " | ".join(map(str, report["histogram"][name])) + " |" for name in ("before", "after")]
    if source:
        lines += ["", f"mAP50 on the labelled frames: {source['before']:.3f} before, {source['after']:.3f} after."]
    lines += ["", "Settings: " + ", ".join(f"{k} {v}" for k, v in settings.items()), ""]
    return "\n".join(lines)
