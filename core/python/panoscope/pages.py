"""What notebooks show: pictures of packets, rows of thumbnails, tables, graphs."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .drawing import draw
from .errors import PanoscopeError
from .packets import CLOUD_POINT, Detections, Table
from .pictures import coloured, gradient, png, usual_range

if TYPE_CHECKING:
    from .graph import Graph
    from .series import Packet, Result, Series

_UNITS = {"disparity": "px", "depth": "mm", "confidence": ""}
"""Maps of numbers, shown in colours."""
_LARGE_PX, _SMALL_PX = 640, 150
_MAX_ROWS = 12
_MAX_THUMBNAILS = 6


def _shrunk(array: np.ndarray, width_px: int) -> np.ndarray:
    """Every so many pixels of an array, so that it is at most that wide."""
    step = -(-array.shape[1] // width_px)
    return array[::step, ::step]


def _picture(value: np.ndarray, packet: str, width_px: int) -> str | None:
    """An array of pixels as an element of a page; points by their colours. None for other arrays."""
    if value.dtype == CLOUD_POINT:
        known = np.asarray(np.isfinite(value["xyz_mm"])).all(2)
        value = np.where(np.expand_dims(known, 2), value["bgr"], 0).astype("u1")
    if value.ndim not in (2, 3) or 0 in value.shape:
        return None
    scale, shown = "", _shrunk(value, width_px)
    if value.dtype == np.float32 and value.ndim == 2 and packet != "image":
        limits = usual_range(value)
        shown = coloured(shown, limits)
        scale = _scale(limits, _UNITS.get(packet, ""), value) if width_px == _LARGE_PX else ""
    bytes_of_png = png(shown)
    if bytes_of_png is None:
        return None
    data = base64.b64encode(bytes_of_png).decode()
    wide = min(value.shape[1], width_px)
    return f'<img style="width: {wide}px; max-width: 100%; display: block; margin: 0" src="data:image/png;base64,{data}">{scale}'


def _scale(limits: tuple[float, float], unit: str, value: np.ndarray) -> str:
    known = 100 * float(np.isfinite(value).mean())
    low, high = (f"{limit:.4g} {unit}".strip() for limit in limits)
    bar = f'<span style="display: inline-block; width: 12em; height: 0.8em; background: linear-gradient(to right, {gradient()})"></span>'
    return f'<div style="font-size: 90%">{low} {bar} {high}, {known:.1f} % known</div>'


def _number(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]], count: int) -> str:
    """A table of at most a dozen rows, of ``count``."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    shown = [row for _, row in zip(range(_MAX_ROWS), rows)]
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(_number(cell))}</td>' for cell in row)}</tr>" for row in shown)
    more = f"<div>{count - len(shown)} more rows</div>" if count > len(shown) else ""
    return f'<div style="overflow-x: auto"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{more}'


def of_table(value: Table) -> str:
    """The rows of a table packet."""
    return table(value.columns, value.rows.tolist(), len(value.rows))


def of_detections(value: Detections) -> str:
    """The boxes with their labels."""
    labels = dict(enumerate(value.labels))
    names = ("score", "x_px", "y_px", "width_px", "height_px", "track_id")
    rows = ([labels.get(int(box["class_index"]), int(box["class_index"])), *(box[name].item() for name in names)] for box in value.boxes)
    return table(["label", *names], rows, len(value.boxes))


def of_value(value: Any, packet: str) -> str:
    """Any value: a picture, a table, the fields of a record, or its text."""
    if isinstance(value, np.ndarray):
        picture = _picture(value, packet, _LARGE_PX)
        return picture if picture is not None else f"<pre>{html.escape(repr(value))}</pre>"
    if isinstance(value, Table):
        return of_table(value)
    if isinstance(value, Detections):
        return of_detections(value)
    if isinstance(value, np.void) and value.dtype.names:
        names = [name for name in value.dtype.names if name != "reserved"]
        return table(["field", "value"], ([name, str(value[name])] for name in names), len(names))
    return f"<pre>{html.escape(str(value))}</pre>"


def _caption(words: str) -> str:
    return f'<div style="font-size: 90%; margin: 0.2em 0">{html.escape(words)}</div>'


def of_packet(packet: Packet) -> str:
    """A packet with its output, tick and age."""
    age = "" if np.isnan(packet.age_ms) else f", {packet.age_ms:.1f} ms old"
    return of_value(packet.value, packet.packet_type()) + _caption(f"{packet.output}, tick {packet.tick}{age}")


def of_series(series: Series) -> str:
    """Thumbnails of some packets of a series; of others a table."""
    count = len(series)
    if count == 0:
        return _caption(f"{series.output}: no packets")
    if not series.holds_arrays():
        return _rows_of(series) + _caption(f"{series.output}: {count} packets")
    indices = sorted({round(at) for at in np.linspace(0, count - 1, min(count, _MAX_THUMBNAILS))})
    cells = []
    for packet in (series.packet(index) for index in indices):
        picture = _picture(packet.value, packet.packet_type(), _SMALL_PX) or html.escape(repr(packet))
        cells.append(f'<div style="display: inline-block; margin-right: 4px">{picture}{_caption(f"tick {packet.tick}")}</div>')
    return f"<div>{''.join(cells)}</div>" + _caption(f"{series.output}: {count} packets of {series[0].shape[1]}x{series[0].shape[0]}")


def _rows_of(series: Series) -> str:
    columns = series[:_MAX_ROWS].columns()
    names = [name for name in columns if name != "capture_ns"]
    rows = list(zip(*(columns[name] for name in names)))
    more = len(series) > _MAX_ROWS
    return table(names, rows, len(rows)) + (f"<div>of the first {_MAX_ROWS} packets</div>" if more else "")


def of_result(result: Result) -> str:
    """The outputs of a run, and what its nodes needed."""
    parts = [of_series(series) for series in result.values()]
    nodes = result.report.get("nodes", {})
    rows = ([name, *(counts.get(key) for key in ("count", "p50_ms", "p99_ms", "dropped", "faults"))] for name, counts in nodes.items())
    if nodes:
        parts.append(table(["node", "count", "p50 ms", "p99 ms", "dropped", "faults"], rows, len(nodes)))
    for fault in result.faults[-3:]:
        parts.append(f'<pre style="color: #b00020">{html.escape(str(fault["node"]))}: {html.escape(str(fault["words"]))}</pre>')
    return "".join(f'<div style="margin-bottom: 0.6em">{part}</div>' for part in parts)


def of_graph(graph: Graph) -> str:
    """The nodes and edges of a graph as a picture, its arguments and its outputs; of one with mistakes the mistakes."""
    named: list[str] = []
    try:
        nodes, edges = graph.native.drawing()
        # As an image: Jupyter removes elements of SVG from a notebook that it does not trust, and leaves their texts.
        data = base64.b64encode(draw(nodes, edges).encode()).decode()
        picture = f'<img style="max-width: none" src="data:image/svg+xml;base64,{data}">'
        named = [f"{nodes[producer][0]}.{output} to {nodes[consumer][0]}.{input}" for producer, output, consumer, input, _ in edges]
        outputs = graph.outputs
    except PanoscopeError as error:
        picture, outputs = f"<pre>{html.escape(str(error))}</pre>", {}
    parts = [f"<div><b>{html.escape(graph.name)}</b></div>", f'<div style="overflow-x: auto">{picture}</div>']
    arguments = graph.native.arguments()
    if arguments:
        rows = ([name, kind, "yes" if is_missing else "", doc] for name, kind, doc, is_missing in arguments)
        parts.append(table(["argument", "type", "must be given", ""], rows, len(arguments)))
    if named:
        parts.append(f"<details><summary>{len(named)} edges</summary>{'<br>'.join(map(html.escape, named))}</details>")
    if outputs:
        listed = "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(packet)}</td></tr>" for name, packet in outputs.items())
        parts.append(f"<details><summary>{len(outputs)} outputs</summary><table>{listed}</table></details>")
    return "".join(parts)
