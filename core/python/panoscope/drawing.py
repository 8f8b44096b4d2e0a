"""Graphs as pictures: nodes in columns, each to the right of what it reads."""

from __future__ import annotations

import html
from collections.abc import Sequence

Edge = tuple[int, str, int, str, bool]
"""Producer, output, consumer, input, and whether the packet is of the tick before."""

_ROW_PX, _GAP_PX, _COLUMN_GAP_PX, _LETTER_PX, _MARGIN_PX = 36, 16, 56, 7.0, 8


def _columns(count: int, edges: Sequence[Edge]) -> list[int]:
    """The column of each node: one further than the last that it reads."""
    columns = [0] * count
    for _ in range(count):
        is_still = True
        for producer, _, consumer, _, is_delayed in edges:
            if not is_delayed and columns[consumer] <= columns[producer]:
                columns[consumer], is_still = columns[producer] + 1, False
        if is_still:
            break
    return columns


def _order(columns: Sequence[int], edges: Sequence[Edge]) -> list[list[int]]:
    """The nodes of each column from above, near those that they read."""
    height: dict[int, float] = {}
    ordered = []
    for column in range(max(columns, default=-1) + 1):
        nodes = [node for node, of in enumerate(columns) if of == column]

        def mean(node: int) -> float:
            above = [height[producer] for producer, _, consumer, _, _ in edges if consumer == node and producer in height]
            return sum(above) / len(above) if above else 0.0

        nodes.sort(key=mean)
        height.update({node: index - (len(nodes) - 1) / 2 for index, node in enumerate(nodes)})
        ordered.append(nodes)
    return ordered


def draw(nodes: Sequence[tuple[str, str]], edges: Sequence[Edge]) -> str:
    """An SVG of nodes (name, type) and edges."""
    columns = _order(_columns(len(nodes), edges), edges)
    step = _ROW_PX + _GAP_PX
    tallest = max((len(column) for column in columns), default=0)
    boxes: dict[int, tuple[float, float, float]] = {}
    x = float(_MARGIN_PX)
    for column in columns:
        width = max(max(len(text) for text in nodes[node]) for node in column) * _LETTER_PX + 16
        for index, node in enumerate(column):
            boxes[node] = (x, _MARGIN_PX + step * (index + (tallest - len(column)) / 2), width)
        x += width + _COLUMN_GAP_PX
    wide, high = x - _COLUMN_GAP_PX + _MARGIN_PX, _MARGIN_PX * 2 + step * tallest - _GAP_PX
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide:.0f}" height="{high:.0f}" font-family="sans-serif" font-size="12">']
    for producer, _, consumer, _, is_delayed in edges:
        (left, top, width), (right, bottom, _) = boxes[producer], boxes[consumer]
        start, end, bend = left + width, right, _COLUMN_GAP_PX / 2
        y0, y1 = top + _ROW_PX / 2, bottom + _ROW_PX / 2
        dashes = ' stroke-dasharray="4 3"' if is_delayed else ""
        path = f"M{start:.0f} {y0:.0f} C{start + bend:.0f} {y0:.0f} {end - bend:.0f} {y1:.0f} {end:.0f} {y1:.0f}"
        lines.append(f'<path d="{path}" fill="none" stroke="#7a8794" stroke-width="1.5"{dashes}/>')
    for node, (left, top, width) in boxes.items():
        name, kind = (html.escape(text) for text in nodes[node])
        lines.append(
            f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{_ROW_PX}" rx="5" fill="#eef3f8" stroke="#4a6785"/>'
            f'<text x="{left + 8:.0f}" y="{top + 15:.0f}" fill="#14202c">{name}</text>'
            f'<text x="{left + 8:.0f}" y="{top + 30:.0f}" fill="#566575" font-size="10">{kind}</text>'
        )
    return "".join(lines) + "</svg>"
