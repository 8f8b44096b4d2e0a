"""Folds of whole operations and the predictions on them; needs Python alone.

Predictions of fold N lie in `foldN.json`, one object:

    {"format": "panoscope-predictions-1", "fold": "1", "held_out": ["v01", ...], "trained_on": ["v03", ...],
     "classes": ["grasper", ...], "network": {...}, "frames": {"v01_002075": [[class, score, x0, y0, x1, y1, objectness], ...], ...}}

Class is an index into `classes`, score and objectness 0..1, boxes in pixels of the stored picture; older files have no objectness. Every frame of the held-out operations is there, one in
which nothing was found with an empty list. `network` says how it was trained, for people.
"""

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path

FORMAT = "panoscope-predictions-1"
SHIPPED = Path(__file__).resolve().parent.parent / "folds.toml"


class FoldsError(ValueError):
    """What is wrong, with the file and how to correct it."""


@dataclass(frozen=True)
class Folds:
    """Operations of each fold, by its name."""

    path: Path
    splits: tuple[str, ...]
    operations: dict[str, tuple[str, ...]]

    def held_out(self, fold):
        """Operations that a training of `fold` must not see."""
        if str(fold) not in self.operations:
            raise FoldsError(f"{self.path}: there is no fold {fold}; there are {', '.join(self.operations)}")
        return self.operations[str(fold)]

    def trained_on(self, fold):
        """Operations that a training of `fold` learns from."""
        held_out = self.held_out(fold)
        return tuple(o for operations in self.operations.values() for o in operations if o not in held_out)

    def check_operations(self, found):
        """Raises where the data has operations that no fold names: whether a training may see them would be left to chance."""
        known = {o for operations in self.operations.values() for o in operations}
        if missing := sorted(set(found) - known):
            raise FoldsError(f"{self.path}: the operations {', '.join(missing)} are in no fold; add them")


def read(path=SHIPPED):
    """The folds of a file; every operation is in one fold only."""
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text())
        splits, folds = tuple(table["splits"]), {str(k): tuple(v) for k, v in table["folds"].items()}
    except FileNotFoundError:
        raise FoldsError(f"{path}: there is no such file of folds") from None
    except tomllib.TOMLDecodeError as wrong:
        raise FoldsError(f"{path}: not TOML: {wrong}") from None
    except KeyError as missing:
        raise FoldsError(f"{path}: `{missing.args[0]}` is missing: `splits` lists the splits, [folds] the operations of each fold") from None
    fold_of = {}
    for fold, operations in folds.items():
        if not operations:
            raise FoldsError(f"{path}: fold {fold} has no operation")
        for operation in operations:
            if operation in fold_of:
                raise FoldsError(f"{path}: operation {operation} is in fold {fold_of[operation]} and in fold {fold}; one has to go")
            fold_of[operation] = fold
    if len(folds) < 2:
        raise FoldsError(f"{path}: {len(folds)} fold; at least two are needed, one to learn from and one to score")
    return Folds(path, splits, folds)


def write_predictions(folder, folds, fold, classes, network, frames):
    """Writes `foldN.json` in `folder`; `frames` maps names to rows of class, score, x0, y0, x1, y1 and, where
    it is known, objectness. Gives its path."""
    rows = {
        name: [[int(r[0]), round(float(r[1]), 4), *(round(float(v), 1) for v in r[2:6]), *(round(float(v), 4) for v in r[6:])] for r in found]
        for name, found in sorted(frames.items())
    }
    value = {
        "format": FORMAT,
        "fold": str(fold),
        "held_out": list(folds.held_out(fold)),
        "trained_on": list(folds.trained_on(fold)),
        "classes": list(classes),
        "network": network,
        "frames": rows,
    }
    path = Path(folder) / f"fold{fold}.json"
    new = path.with_suffix(".new")
    new.write_text(json.dumps(value, separators=(",", ":")) + "\n")
    new.replace(path)
    return path
