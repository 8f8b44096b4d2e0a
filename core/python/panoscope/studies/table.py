"""The data set of a study: ``table/runs.parquet`` with a row per run, ``table/ticks.parquet`` with a row per tick, ``table/attempts.parquet`` with what
each run cost. The first two have no times of the clock: the same study gives the same bytes wherever and in whatever order its runs were done."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..columns import needed
from .plan import HASHES, Run
from .store import TICKS, Store, read_json
from .values import number
from .worker import STATISTICS

OPEN = "open"
RUNS_FILE, TICKS_FILE, ATTEMPTS_FILE = "runs.parquet", "ticks.parquet", "attempts.parquet"
_GROUP_ROWS = 100_000


def _cells(run: Run) -> dict[str, Any]:
    """Columns of the input, and swept parameters."""
    return {**run.columns, **run.params}


def row_of(run: Run, position: int, result: Mapping[str, Any], hashes: Mapping[str, str]) -> dict[str, Any]:
    """The row of a run; ``result`` may be empty."""
    row: dict[str, Any] = {"run": run.key, "number": position, "status": result.get("status", OPEN), "error": result.get("error")}
    row.update(_cells(run))
    known = result.get("hashes", hashes)
    row.update({name: known.get(name.removesuffix("_hash")) for name in HASHES})
    row.update({"frames": result.get("frames"), "failed_calls": result.get("failed_calls")})
    row["files"] = list(result.get("files", []))
    for measure, values in sorted(result.get("measures", {}).items()):
        row.update({f"{measure}.{statistic}": values[statistic] for statistic in STATISTICS})
    return row


def _typed(arrow: Any, name: str, values: Sequence[Any]) -> Any:
    """A column of one type: numbers where all cells are numbers, also as texts of a CSV file."""
    if name == "files":
        return arrow.array(values, arrow.list_(arrow.string()))
    read = [number(value) if isinstance(value, str) else value for value in values]
    kinds = {type(value) for value in read if value is not None and value != ""}
    if kinds <= {bool} and kinds:
        return arrow.array([None if value == "" else value for value in read], arrow.bool_())
    if kinds and kinds <= {int, float}:
        kind = arrow.int64() if kinds == {int} and all(abs(value) < 2**63 for value in read if value not in (None, "")) else arrow.float64()
        return arrow.array([None if value == "" else value for value in read], kind)
    return arrow.array([None if value is None else str(value) for value in values], arrow.string())


def _ordered(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of all columns in the order in which they come, then measures by name: runs may have different ones."""
    names = dict.fromkeys(name for row in rows for name in row)
    measures = sorted(name for name in names if "." in name and name.rpartition(".")[2] in STATISTICS)
    return [*(name for name in names if name not in set(measures)), *measures]


def write_rows(rows: Sequence[Mapping[str, Any]], store: Store, file: str) -> None:
    """Writes rows of any columns as a file of the data set."""
    arrow, parquet = needed("pyarrow", "a data set"), needed("pyarrow.parquet", "a data set")
    columns = {name: _typed(arrow, name, [row.get(name) for row in rows]) for name in _ordered(rows)}
    with store.replacing(store.table / file) as part:
        parquet.write_table(arrow.table(columns), part, row_group_size=_GROUP_ROWS)


def write_attempts(runs: Iterable[Run], store: Store) -> None:
    """What each run cost and where it was done."""
    rows = []
    for run in runs:
        known = read_json(store.run(run.key) / "attempt.json") or read_json(store.failed(run.key) / "attempt.json")
        if known is not None:
            rows.append({"run": run.key, "status": "", **known})
    if rows:
        write_rows(rows, store, ATTEMPTS_FILE)


def write_ticks(runs: Sequence[Run], store: Store) -> None:
    """All ticks of the runs that are done, in their order; a run at a time is in memory. Without any there is no such file."""
    arrow, parquet = needed("pyarrow", "a data set"), needed("pyarrow.parquet", "a data set")
    files = [(position, run, store.run(run.key) / TICKS) for position, run in enumerate(runs, 1)]
    files = [(position, run, file) for position, run, file in files if file.is_file()]
    if not files:
        (store.table / TICKS_FILE).unlink(missing_ok=True)
        return
    measures = sorted(set().union(*(parquet.read_schema(file).names[3:] for _, _, file in files)))
    fixed = [("run", arrow.string()), ("number", arrow.int64())]
    fixed += [(name, arrow.int64()) for name in ("source", "tick", "capture_ns")]
    schema = arrow.schema(fixed + [(name, arrow.float64()) for name in measures])
    waiting: list[Any] = []
    with store.replacing(store.table / TICKS_FILE) as part, parquet.ParquetWriter(part, schema) as writer:
        for position, run, file in files:
            table = parquet.read_table(file)
            count = table.num_rows
            columns = [arrow.array([run.key] * count), arrow.array([position] * count, arrow.int64())]
            columns += [table[name] if name in table.column_names else arrow.nulls(count, arrow.float64()) for name in schema.names[2:]]
            waiting.append(arrow.table(columns, schema=schema))
            if sum(one.num_rows for one in waiting) >= _GROUP_ROWS:
                writer.write_table(arrow.concat_tables(waiting), row_group_size=_GROUP_ROWS)
                waiting = []
        if waiting:
            writer.write_table(arrow.concat_tables(waiting), row_group_size=_GROUP_ROWS)
