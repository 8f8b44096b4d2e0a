"""Statistics of the rows of a study, by Polars, which reads only the columns that it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from ..columns import needed
from .store import StudyError
from .table import RUNS_FILE

MEAN = ".mean"
_T_975 = dict(enumerate((12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646, 2.3060, 2.2622), 1))
_Z_975 = 1.959964
BINS = 40
LARGER = ("ap50", "precision", "recall", "coverage", "inliers", "density", "confidence", "fps", "hz")
"""Parts of the names of measures of which more is better."""


def t_975(freedom: int) -> float:
    """The 97.5 % quantile of Student's distribution (Abramowitz and Stegun, 26.7.5)."""
    if freedom in _T_975:
        return _T_975[freedom]
    z, n = _Z_975, freedom
    terms = (
        (z**3 + z) / (4 * n),
        (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2),
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3),
    )
    return z + sum(terms)


def is_larger_better(measure: str, larger: Sequence[str] = (), smaller: Sequence[str] = ()) -> bool:
    """Whether more of a measure is better: as asked, else by its name, as `panoscope sweep` has it."""
    if measure in larger or measure in smaller:
        return measure in larger
    return any(part in measure for part in LARGER)


@dataclass(frozen=True)
class Interval:
    """A mean with its 95 % interval; the interval is unknown for fewer than two values."""

    count: int
    mean: float
    deviation: float
    half_width: float

    @staticmethod
    def of(count: int, mean: Optional[float], deviation: Optional[float]) -> Interval:
        """From the number of values, their mean and their standard deviation (of the sample)."""
        if count < 2 or mean is None or deviation is None:
            return Interval(count, math.nan if mean is None else mean, math.nan, math.nan)
        return Interval(count, mean, deviation, t_975(count - 1) * deviation / math.sqrt(count))


@dataclass(frozen=True)
class Summary:
    """A measure over the runs of a group."""

    group: tuple[Any, ...]
    interval: Interval
    low: float
    median: float
    high: float
    """5 %, 50 % and 95 % of the runs are below."""


@dataclass(frozen=True)
class Paired:
    """The same runs of two studies: second minus first."""

    measure: str
    first_mean: float
    second_mean: float
    difference: Interval
    better_share: float
    """Share of the runs that are better in the second study."""

    @property
    def is_significant(self) -> bool:
        """Whether the interval of the difference leaves out 0."""
        return abs(self.difference.mean) > self.difference.half_width


class Table:
    """The rows of a study."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "table" / RUNS_FILE
        if not self.file.is_file():
            raise StudyError(f"{folder} is not a study: {self.file} does not exist; `panoscope batch` writes it")
        self._pl = needed("polars", "a report of a study")
        self.frame = self._pl.scan_parquet(self.file)
        self.columns: list[str] = self.frame.collect_schema().names()
        self._loaded: tuple[Any, Any] = (None, None)
        """What was read last, and its rows: everything about a measure is computed from one reading."""

    @property
    def measures(self) -> list[str]:
        """All measures."""
        return [name[: -len(MEAN)] for name in self.columns if name.endswith(MEAN)]

    def checked(self, measures: Sequence[str]) -> list[str]:
        """The measures that were asked for; all without any."""
        unknown = [measure for measure in measures if measure not in self.measures]
        if unknown:
            raise StudyError(f"{self.folder} has no measure `{unknown[0]}`; it has {', '.join(self.measures) or 'none'}")
        return list(measures) or self.measures

    def values(self, measure: str, more: Sequence[str] = ()) -> Any:
        """The mean of a measure in each run that has one, as column ``value``; lazy. Runs that failed have none."""
        col = self._pl.col
        value = col(measure + MEAN).cast(self._pl.Float64).alias("value")
        return self.frame.select(value, *(col(name) for name in more)).filter(col("value").is_finite())

    def _read(self, measure: str, by: Sequence[str]) -> Any:
        wanted = (measure, tuple(by))
        if self._loaded[0] != wanted:
            # The rows before go first: two measures need not fit into the memory.
            self._loaded = (None, None)
            self._loaded = (wanted, self.values(measure, ["number", *by]).collect(engine="streaming"))
        return self._loaded[1]

    def statuses(self) -> dict[str, int]:
        """Number of runs by status."""
        counts = self.frame.group_by("status").len().collect(engine="streaming")
        return {str(status): int(count) for status, count in counts.rows()}

    def errors(self, most: int = 50) -> list[tuple[str, str, int]]:
        """Errors of failed runs, the most frequent first: the error, one of its runs, and how many have it."""
        col = self._pl.col
        failed = self.frame.filter(col("status") == "failed").group_by("error").agg(col("run").min(), self._pl.len())
        return [(str(error), str(run), int(count)) for error, run, count in failed.sort(["len", "error"], descending=[True, False]).head(most).collect().rows()]

    def summaries(self, measure: str, by: Sequence[str], groups: Sequence[str] = ()) -> list[Summary]:
        """A measure over all runs, or for each group of them. ``groups`` are columns that later calls group by: they are read at once."""
        value = self._pl.col("value")
        facts = [value.len().alias("n"), value.mean().alias("mean"), value.std().alias("std")]
        facts += [value.quantile(share, "linear").alias(f"q{share}") for share in (0.05, 0.5, 0.95)]
        rows = self._read(measure, by or groups)
        found = rows.group_by(list(by)).agg(facts).sort(list(by)) if by else rows.select(facts)
        summaries = []
        for row in found.rows():
            group, (count, mean, deviation, *quantiles) = row[: len(by)], row[len(by) :]
            low, median, high = (math.nan if quantile is None else quantile for quantile in quantiles)
            summaries.append(Summary(group, Interval.of(count, mean, deviation), low, median, high))
        return summaries

    def histogram(self, measure: str, groups: Sequence[str] = ()) -> tuple[float, float, list[int]]:
        """Least and largest value, and the number of runs in each of 40 parts between them."""
        values = self._read(measure, groups)["value"]
        if not len(values):
            return math.nan, math.nan, []
        low, high = float(values.min()), float(values.max())
        width = (high - low) / BINS or 1.0
        bins = ((values - low) / width).cast(self._pl.UInt8).clip(0, BINS - 1)
        counts = dict(bins.value_counts().rows())
        return low, high, [int(counts.get(index, 0)) for index in range(BINS)]

    def worst(self, measure: str, most: int, is_larger: bool, more: Sequence[str] = (), groups: Sequence[str] = ()) -> list[dict[str, Any]]:
        """The worst runs, the worst first; those of equal value in the order of the table."""
        rows, col = self._read(measure, groups).select("value", "number"), self._pl.col
        ends = rows["value"].bottom_k(most) if is_larger else rows["value"].top_k(most)
        if not len(ends):
            return []
        is_bad = col("value") <= ends.max() if is_larger else col("value") >= ends.min()
        order: dict[str, Any] = {"by": ["value", "number"], "descending": [not is_larger, False]}
        found = rows.filter(is_bad).sort(**order).head(most)
        names = list(dict.fromkeys(["number", "run", *(name for name in more if name in self.columns)]))
        facts = self.frame.select(names).filter(col("number").is_in(found["number"].to_list())).collect(engine="streaming")
        return list(found.join(facts, on="number", how="left").sort(**order).to_dicts())


def paired(first: Table, second: Table, measure: str, is_larger: bool) -> Paired:
    """Compares the runs that two studies have in common: the same arguments and the same swept values."""
    pl = first._pl
    both = first.values(measure, ["run"]).join(second.values(measure, ["run"]), on="run", suffix="_second")
    difference = pl.col("value_second") - pl.col("value")
    is_better = difference > 0 if is_larger else difference < 0
    facts = both.select(
        pl.len(), pl.col("value").mean().alias("a"), pl.col("value_second").mean().alias("b"), difference.mean().alias("mean"),
        difference.std().alias("std"), is_better.mean().alias("share"),
    )  # fmt: skip
    count, mean_a, mean_b, mean, deviation, share = facts.collect(engine="streaming").row(0)
    if not count:
        raise StudyError(f"{first.folder} and {second.folder} have no run in common that has {measure}: the same arguments and swept values make the same run")
    return Paired(measure, mean_a, mean_b, Interval.of(count, mean, deviation), share)
