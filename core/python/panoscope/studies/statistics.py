"""Statistics of the rows of a study, by Polars, which reads only the columns that it needs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
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
SHARES = (0.05, 0.5, 0.95)
_ROWS_AT_ONCE = 1_000_000
LARGER = ("ap50", "precision", "recall", "coverage", "inliers", "density", "confidence", "fps", "_hz")
"""Parts of the names of measures of which more is better; those of `panoscope sweep`."""


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
    losses: list[tuple[int, float, float]]
    """Runs that got worse, the most so first: number in the first study, and both values."""

    @property
    def is_significant(self) -> bool:
        """Whether the interval of the difference leaves out 0."""
        return abs(self.difference.mean) > self.difference.half_width


class Table:
    """The rows of a study. The column ``number`` is the position of a row, from 1."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "table" / RUNS_FILE
        if not self.file.is_file():
            raise StudyError(f"{folder} is not a study: {self.file} does not exist; `panoscope batch` writes it")
        self.pl = needed("polars", "a report of a study")
        self.frame = self.pl.scan_parquet(self.file)
        self.columns: list[str] = self.frame.collect_schema().names()

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

    def value(self, measure: str) -> Any:
        """The mean of a measure in each run, as an expression; null where it has none, as in runs that failed."""
        value = self.pl.col(measure + MEAN).cast(self.pl.Float64)
        return self.pl.when(value.is_finite()).then(value).alias("value")

    def rows(self, numbers: Sequence[int], columns: Iterable[str]) -> dict[int, dict[str, Any]]:
        """Some rows, by number; of the columns those that there are."""
        names = ["number", *(name for name in dict.fromkeys(columns) if name in self.columns and name != "number")]
        rows = self.frame.select(names).filter(self.pl.col("number").is_in(list(numbers))).collect(engine="streaming")
        return {int(row["number"]): row for row in rows.to_dicts()}

    def statuses(self) -> dict[str, int]:
        """Number of runs by status."""
        counts = self.frame.group_by("status").len().collect(engine="streaming")
        return {str(status): int(count) for status, count in counts.rows()}

    def errors(self, most: int = 50) -> list[tuple[str, str, int]]:
        """Errors of failed runs, the most frequent first: the error, one of its runs, and how many have it."""
        col = self.pl.col
        failed = self.frame.filter(col("status") == "failed").group_by("error").agg(col("number").min(), self.pl.len())
        found = failed.sort(["len", "error"], descending=[True, False]).head(most).collect(engine="streaming").rows()
        runs = self.rows([number for _, number, _ in found], ["run"])
        return [(str(error), str(runs[number]["run"]), int(count)) for error, number, count in found]


class Measure:
    """A measure over the runs of a study, read once: ten million values are 80 MB."""

    def __init__(self, table: Table, name: str, by: Sequence[str] = ()) -> None:
        self.table, self.by = table, list(by)
        columns = [table.value(name), *(table.pl.col(column).alias(f"by {column}") for column in by)]
        rows = table.frame.select(columns).with_row_index("number", 1).filter(table.pl.col("value").is_not_null())
        self._rows = rows.collect(engine="streaming")
        self._ordered = self._rows["value"].sort()

    def summary(self) -> Summary:
        """Over all runs."""
        ordered = self._ordered
        return _summary((), len(ordered), ordered.mean(), ordered.std(), [ordered.quantile(share, "linear") for share in SHARES])

    def groups(self) -> list[Summary]:
        """Over the runs of each group."""
        value, names = self.table.pl.col("value"), [f"by {column}" for column in self.by]
        facts = [value.len().alias("count"), value.mean().alias("mean"), value.std().alias("deviation")]
        facts += [value.quantile(share, "linear").alias(f"{share}") for share in SHARES]
        found = self._rows.group_by(names).agg(facts).sort(names)
        split = [(row[: len(names)], row[len(names) :]) for row in found.rows()]
        return [_summary(group, count, mean, deviation, quantiles) for group, (count, mean, deviation, *quantiles) in split]

    def histogram(self) -> tuple[float, float, list[int]]:
        """Least and largest value, and the number of runs in each of 40 parts between them."""
        ordered = self._ordered
        if not len(ordered):
            return math.nan, math.nan, []
        low, high = float(ordered[0]), float(ordered[-1])
        starts = [int(ordered.search_sorted(low + (high - low) * index / BINS)) for index in range(BINS)] + [len(ordered)]
        return low, high, [end - start for start, end in zip(starts, starts[1:])]

    def worst(self, most: int, is_larger: bool, more: Iterable[str] = ()) -> list[dict[str, Any]]:
        """The worst runs, the worst first: number, value, run, and more columns; those of equal value in the order of the table."""
        ordered = self._ordered
        most = min(most, len(ordered))
        if not most:
            return []
        value = self.table.pl.col("value")
        worst = self._rows.filter(value <= ordered[most - 1] if is_larger else value >= ordered[-most]).select("number", "value")
        found = worst.sort(["value", "number"], descending=[not is_larger, False]).head(most)
        facts = self.table.rows(found["number"].to_list(), ["run", *more])
        return [{**facts[row["number"]], **row} for row in found.to_dicts()]


class Pairs:
    """The runs that two studies have in common: the same arguments and the same swept values."""

    def __init__(self, first: Table, second: Table) -> None:
        self.first, self.second = first, second
        self._is_aligned = _have_same_rows(first, second)

    def _values(self, measure: str) -> Any:
        """Columns ``number`` (in the first study), ``a`` and ``b``: values of the runs that have one in both studies."""
        pl, tables = self.first.pl, (self.first, self.second)
        if self._is_aligned:
            a, b = (table.frame.select(table.value(measure)).collect()["value"] for table in tables)
            return pl.DataFrame({"a": a, "b": b}).with_row_index("number", 1).drop_nulls()
        # A key has 64 bits: as a number it takes a third of the memory.
        key = pl.col("run").str.to_integer(base=16, dtype=pl.UInt64)
        a, b = (table.frame.select(key, "number", table.value(measure).alias(name)).drop_nulls() for table, name in zip(tables, "ab"))
        return a.join(b, on="run").select("number", "a", "b").collect(engine="streaming")

    def compare(self, measure: str, is_larger: bool, losses: int = 0) -> Paired:
        """Compares a measure in the runs that have it in both studies."""
        pl, both = self.first.pl, self._values(measure)
        if not len(both):
            folders = f"{self.first.folder} and {self.second.folder}"
            raise StudyError(f"{folders} have no run in common that has {measure}: the same arguments and swept values make the same run")
        difference = both["b"] - both["a"]
        loss = -difference if is_larger else difference
        interval = Interval.of(len(both), difference.mean(), difference.std())
        end = max(loss.top_k(losses).min() or 0.0, 0.0) if losses else math.inf
        worse = both.with_columns(loss.alias("loss")).filter((pl.col("loss") >= end) & (pl.col("loss") > 0))
        worse = worse.sort(["loss", "number"], descending=[True, False]).head(losses).select("number", "a", "b")
        return Paired(measure, float(both["a"].mean()), float(both["b"].mean()), interval, float((loss < 0).mean()), worse.rows())


def _summary(group: tuple[Any, ...], count: int, mean: Optional[float], deviation: Optional[float], quantiles: Sequence[Optional[float]]) -> Summary:
    low, median, high = (math.nan if quantile is None else quantile for quantile in quantiles)
    return Summary(group, Interval.of(count, mean, deviation), low, median, high)


def _have_same_rows(first: Table, second: Table) -> bool:
    """Whether the same runs stand in the same order, as they do where only the graph differs: then nothing needs to be joined."""
    pl = first.pl
    count, other = (table.frame.select(pl.len()).collect().item() for table in (first, second))
    if count != other:
        return False
    for start in range(0, count, _ROWS_AT_ONCE):
        keys = [table.frame.select("run").slice(start, _ROWS_AT_ONCE).collect()["run"] for table in (first, second)]
        if not (keys[0] == keys[1]).all():
            return False
    return True
