"""Where mistakes of a graph that was built stand: in the calls that built it."""

from __future__ import annotations

import linecache
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_PACKAGE = str(Path(__file__).parent)


@dataclass(frozen=True, eq=False)
class Place:
    """A call: its file and its lines, from 1."""

    file: str
    line: int
    last: int


@dataclass(frozen=True, eq=False)
class Span:
    """Part of a line of a graph's text, and the call that it comes from."""

    line: int
    start: int
    end: int
    place: Place
    patterns: tuple[str, ...]
    """What it looks like in the call, the closest first."""


def caller() -> Place:
    """The innermost call from outside of the package."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame = frame.f_back
    line = last = frame.f_lineno
    # Python 3.11 knows the end of a call.
    positions = getattr(frame.f_code, "co_positions", None)
    if positions is not None:
        found = list(positions())[frame.f_lasti // 2]
        line, last = found[0] or line, found[1] or last
    return Place(frame.f_code.co_filename, line, last)


def span_of(entry: dict[str, Any], path: str, spans: list[Span]) -> Span | None:
    """The part of the text that a mistake is about, if it is about a call."""
    if entry["file"] != path:
        return None
    of_line = [span for span in spans if span.line == entry["line"]]
    return next((span for span in of_line if span.start < entry["column"] <= span.end), of_line[0] if of_line else None)


def moved_to(entry: dict[str, Any], span: Span | None) -> dict[str, Any]:
    """A mistake, or a warning, at the call."""
    if span is None:
        return entry
    place = span.place
    lines = [(number, linecache.getline(place.file, number).rstrip("\n")) for number in range(place.line, place.last + 1)]
    found = ((number, text, re.search(pattern, text)) for pattern in span.patterns for number, text in lines)
    number, text, match = next((one for one in found if one[2]), (place.line, lines[0][1] if lines else "", None))
    column, width = (match.start() + 1, max(match.end() - match.start(), 1)) if match else (1, max(len(text), 1))
    # Other places are lines of a text that nobody sees.
    return {**entry, "file": place.file, "line": number, "column": column, "line_text": text, "width": width, "notes": []}


def render(entries: list[dict[str, Any]]) -> str:
    """Mistakes as ``panoscope check`` prints them."""
    return "\n\n".join(map(_render, entries))


def _render(entry: dict[str, Any]) -> str:
    number = str(entry["line"])
    pad = " " * len(number)
    head = f"{entry['severity']}[{entry['code']}]: {entry['message']}"
    lines = [head, f"{pad}--> {entry['file']}:{number}:{entry['column']}"]
    if entry["line"]:
        under = " " * (entry["column"] - 1) + "^" * entry.get("width", 1)
        lines += [f"{pad} |", f"{number} | {entry['line_text']}", f"{pad} | {under} {entry['label']}".rstrip()]
    if entry["help"]:
        lines.append(f"{pad} = help: {entry['help']}")
    return "\n".join(lines)
