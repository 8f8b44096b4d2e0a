"""What the pictures looked like that a detector learned from, and how unlike them another picture is.

An exported detector has a second output, `features`: its features of stride 8, averaged over cells of 32 x 32 px. Their mean over the picture says how
it looks: colour, light, texture, sharpness. The file's metadata keeps the mean of these numbers over the pictures learned from, and a matrix that makes
their deviations alike and independent. The `yolo` node computes the same (`plugins/tools/src/pictures.rs`). Needs NumPy.
"""

from dataclasses import dataclass

import numpy as np

FORMAT = "panoscope-pictures-1"
OUTPUT = "features"
# Pixels of the input in a cell of the output.
CELL = 32
# Least variance, as a share of a number's own, of any direction: a few operations leave many directions nearly without deviation.
FLOOR = 0.05
# Of pictures of an operation left out, the share that the limit holds.
HELD = 0.99
# Where less than three operations are known, the limit is the quantile of their own pictures times this.
OWN = 1.6


def mean_features(features, size):
    """Mean of a picture's C x H x W `features` over the cells that it fills; `size` is its width and height in the network's input, px."""
    columns, rows = max(1, size[0] // CELL), max(1, size[1] // CELL)
    return features[:, :rows, :columns].mean((1, 2))


@dataclass(frozen=True)
class Statistics:
    """Mean of the numbers, the matrix that makes their deviations alike and independent, and the least value that counts as unlike."""

    mean: np.ndarray
    whitening: np.ndarray
    limit: float = float("nan")

    @staticmethod
    def of(rows, groups):
        """From a row of numbers per picture and the operation of each; each operation counts alike."""
        rows = np.asarray(rows, float)
        _, index, counts = np.unique(np.asarray(groups), return_inverse=True, return_counts=True)
        weight = 1.0 / counts[index] / len(counts)
        mean = weight @ rows
        spread = np.sqrt(weight @ (rows - mean) ** 2) + 1e-4
        off = (rows - mean) / spread
        values, vectors = np.linalg.eigh((off * weight[:, None]).T @ off)
        return Statistics(mean, (vectors / np.sqrt(np.maximum(values, FLOOR))).T / spread)

    @staticmethod
    def with_limit(rows, groups):
        """The same, with a limit that `HELD` of the pictures of each operation stay below when statistics of the others judge them."""
        rows, groups = np.asarray(rows, float), np.asarray(groups)
        names = np.unique(groups)
        whole = Statistics.of(rows, groups)
        if len(names) > 2:
            held = [Statistics.of(rows[groups != n], groups[groups != n]).unlikeness(rows[groups == n]) for n in names]
            limit = np.quantile(np.concatenate(held), HELD)
        else:
            limit = OWN * np.quantile(whole.unlikeness(rows), HELD)
        return Statistics(whole.mean, whole.whitening, float(limit))

    def unlikeness(self, rows):
        """Root of the mean squared deviation of each row, in standard deviations: about 1 for pictures like those learned from."""
        z = (np.atleast_2d(rows) - self.mean) @ self.whitening.T
        return np.sqrt((z**2).mean(1))

    def metadata(self, kind=1):
        """As a model file keeps it: mean, then the matrix row by row; and the limit. Further kinds of pictures are numbered from 2 on."""
        numbers = [*self.mean, *self.whitening.ravel()]
        key = "pictures" if kind == 1 else f"pictures_{kind}"
        return {key: f"{FORMAT} " + " ".join(f"{v:.5g}" for v in numbers), f"{key}_limit": f"{self.limit:.4g}"}


def metadata_of(kinds):
    """The metadata of several kinds of pictures: a picture is unlike all when it is unlike each."""
    merged = {}
    for number, kind in enumerate(kinds, 1):
        merged |= kind.metadata(number)
    return merged
