"""Instruments that the labels of a data set leave out, read from a TOML file.

    data = "m2cai16-tool-locations"
    [[missing]]
    frame = "v02_019125"
    class = "grasper"
    box = [63, 120, 211, 201]      # x0, y0, x1, y1 in px of the stored frame
"""

import tomllib
from pathlib import Path

import numpy as np

from .data import CLASSES

SHIPPED = Path(__file__).resolve().parent.parent / "missing_labels.toml"


class MissingLabelsError(ValueError):
    """What is wrong, with the file and the entry."""


def read(path, classes=CLASSES):
    """Rows (class, x0, y0, x1, y1) of each frame, by its name."""
    path, rows = Path(path), {}
    try:
        entries = tomllib.loads(path.read_text())["missing"]
    except FileNotFoundError:
        raise MissingLabelsError(f"{path}: there is no such file of missing labels") from None
    except tomllib.TOMLDecodeError as wrong:
        raise MissingLabelsError(f"{path}: not TOML: {wrong}") from None
    except KeyError:
        raise MissingLabelsError(f"{path}: no entry [[missing]] in it") from None
    for number, entry in enumerate(entries, 1):
        try:
            frame, kind, (x0, y0, x1, y1) = entry["frame"], classes.index(entry["class"]), map(float, entry["box"])
        except (KeyError, TypeError, ValueError):
            raise MissingLabelsError(
                f"{path}: entry {number}: give `frame`, `class` (one of {', '.join(classes)}) and `box` (x0, y0, x1, y1)"
            ) from None
        if not (0 <= x0 < x1 and 0 <= y0 < y1):
            raise MissingLabelsError(f"{path}: entry {number}, frame `{frame}`: a box is x0, y0, x1, y1 with x0 < x1 and y0 < y1")
        rows.setdefault(frame, []).append([kind, x0, y0, x1, y1])
    return rows


def add(frames, rows):
    """Adds the rows to the frames that have them, which are not loaded yet; returns how many were added."""
    added = 0
    for frame in frames:
        if more := rows.get(frame.name):
            w, h = frame.size
            frame.boxes = np.vstack((frame.boxes, np.minimum(more, [np.inf, w, h, w, h]))).astype(np.float32)
            added += len(more)
    return added
