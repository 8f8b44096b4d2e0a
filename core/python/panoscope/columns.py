"""Values of outputs as columns, for tables of other libraries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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


class Columns:
    """What has columns becomes a table of pandas, Polars or Arrow, whichever is installed."""

    def columns(self) -> Mapping[str, list[Any]]:
        """The columns by their names, all of one length."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``."""
        import pandas  # type: ignore[import-not-found, import-untyped, unused-ignore]

        return pandas.DataFrame(self.columns())

    def to_polars(self) -> Any:
        """A ``polars.DataFrame``."""
        import polars  # type: ignore[import-not-found, unused-ignore]

        return polars.DataFrame(self.columns(), strict=False)

    def to_arrow(self) -> Any:
        """A ``pyarrow.Table``; ``pyarrow.parquet.write_table`` writes it."""
        import pyarrow  # type: ignore[import-not-found, import-untyped, unused-ignore]

        return pyarrow.table(dict(self.columns()))
