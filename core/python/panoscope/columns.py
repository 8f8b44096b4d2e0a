"""Values of outputs as columns, for tables of other libraries."""

from __future__ import annotations

import csv
import importlib
import json
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .packets import Detections, Table

if TYPE_CHECKING:
    from .series import Packet

_Row = dict[str, Any]


def _fields(value: Any, name: str) -> _Row:
    """The numbers and texts of one value under their names; those of an array get their index."""
    if isinstance(value, np.void) and value.dtype.names:
        row: _Row = {}
        for field in value.dtype.names:
            if field != "reserved":
                row.update(_fields(value[field], f"{name}.{field}" if name else field))
        return row
    if isinstance(value, np.ndarray):
        return {f"{name}[{','.join(map(str, index))}]": item.item() for index, item in np.ndenumerate(value)}
    if isinstance(value, bytes):
        return {name: value.decode(errors="replace")}
    return {name or "value": value.item() if isinstance(value, np.generic) else value}


def _rows(value: Any) -> Iterable[_Row]:
    """The rows of one packet: one for a number, a text or a record, one for each row of a table and each box."""
    if isinstance(value, Table):
        return (dict(zip(value.columns, row.tolist())) for row in value.rows)
    if isinstance(value, Detections):
        labels = dict(enumerate(value.labels))
        return ({**_fields(box, ""), "label": labels.get(int(box["class_index"]), "")} for box in value.boxes)
    if isinstance(value, np.ndarray):
        raise TypeError("pixels and points have no columns: take the arrays, as in `numpy.asarray(series)`")
    return (_fields(value, ""),)


def of_packets(packets: Iterable[Packet]) -> dict[str, list[Any]]:
    """Columns ``tick``, ``capture_ns``, ``age_ms`` and those of the values; ``None`` where a packet lacks a column."""
    columns: dict[str, list[Any]] = {"tick": [], "capture_ns": [], "age_ms": []}
    count = 0
    for packet in packets:
        for row in _rows(packet.value):
            row = {"tick": packet.tick, "capture_ns": packet.capture_ns, "age_ms": packet.age_ms, **row}
            for name in row.keys() - columns.keys():
                columns[name] = [None] * count
            for name, values in columns.items():
                values.append(row.get(name))
            count += 1
    return columns


def needed(package: str, what_for: str) -> Any:
    """A package that need not be installed; an error says how to get it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        name = package.partition(".")[0]
        raise ImportError(f"{what_for} needs {name}, which is missing in {sys.prefix}; install it there: `{sys.executable} -m pip install {name}`") from error


class Columns:
    """What has columns becomes a table of pandas, Polars or Arrow, whichever is installed, or a Parquet file."""

    def columns(self) -> Mapping[str, list[Any]]:
        """The columns by their names, all of one length."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``."""
        return needed("pandas", "`to_pandas`").DataFrame(self.columns())

    def to_polars(self) -> Any:
        """A ``polars.DataFrame``."""
        return needed("polars", "`to_polars`").DataFrame(self.columns(), strict=False)

    def to_arrow(self) -> Any:
        """A ``pyarrow.Table``."""
        arrow = needed("pyarrow", "`to_arrow`")
        return arrow.table({name: _of_one_type(values) for name, values in self.columns().items()})

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Writes a Parquet file; needs pyarrow."""
        needed("pyarrow.parquet", "a Parquet file").write_table(self.to_arrow(), os.fspath(path))


def _of_one_type(values: list[Any]) -> list[Any]:
    """The values as texts if numbers and texts are mixed: a column of Arrow has one type."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} or not kinds - {int, float, bool} or len(kinds) == 1:
        return values
    return [None if value is None else str(value) for value in values]


class Rows(list[dict[str, Any]], Columns):
    """Rows of a table, each with its values by their names: ``rows[0]["match.search_px"]``."""

    def columns(self) -> dict[str, list[Any]]:
        """The columns of all rows; ``None`` where a row lacks one."""
        names = dict.fromkeys(name for row in self for name in row)
        return {name: [row.get(name) for row in self] for name in names}

    def _repr_html_(self) -> str:
        from . import pages

        columns = self.columns()
        return pages.table(list(columns), zip(*columns.values()), len(self))


def _cell(text: str) -> Any:
    """A number where the text is one."""
    try:
        return float(text) if text else None
    except ValueError:
        return text


def rows_of_report(report: Mapping[str, Any]) -> Rows:
    """A row for each node of a report."""
    return Rows({"node": node, **{name: value for name, value in counts.items() if not isinstance(value, (dict, list))}} for node, counts in report["nodes"].items())


def _flat(row: Mapping[str, Any], name: str = "") -> _Row:
    """A row whose records are columns of their own: ``tip.u_px``."""
    flat: _Row = {}
    for key, value in row.items():
        flat.update(_flat(value, f"{name}{key}.") if isinstance(value, dict) else {f"{name}{key}": value})
    return flat


def _of_line(line: Mapping[str, Any]) -> list[_Row]:
    """The rows of a line of ``write_table``: one for each row of a table and each box, as its CSV has them."""
    lists = {key: value for key, value in line.items() if isinstance(value, list) and all(isinstance(row, dict) for row in value)}
    head = _flat({key: value for key, value in line.items() if key not in lists})
    return [{**head, **_flat(row)} for rows in lists.values() for row in rows] if lists else [head]


def read_table(path: str | os.PathLike[str]) -> Rows:
    """A table that Panoscope wrote: CSV or JSON lines of ``write_table``, CSV or JSON of ``panoscope sweep`` and ``panoscope export``, or the nodes of
    a report of ``panoscope run --report``."""
    file = Path(path)
    text = file.read_text(encoding="utf-8")
    if file.suffix.lower() == ".csv":
        return Rows({name: _cell(value) for name, value in row.items()} for row in csv.DictReader(text.splitlines()))
    try:
        read = json.loads(text)
    except json.JSONDecodeError:
        read = [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(read, dict) and isinstance(read.get("nodes"), dict):
        return rows_of_report(read)
    rows = read if isinstance(read, list) else [read]
    if not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"{file} is not a table: neither CSV, nor JSON lines, nor a report")
    return Rows(row for line in rows for row in _of_line(line))
