"""One page about a study, or about two that are compared: complete in itself, without scripts, with no address but those of the runs' folders."""

from __future__ import annotations

import base64
import html
import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Optional, Union
from urllib.parse import quote

from .statistics import Measure, Paired, Pairs, Summary, Table, is_larger_better
from .store import LOG, MARK, Store, StudyError, read_json

_WORST = 10
_PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_LONG = 60
"""Characters of a text that gets several lines."""
_PICTURED = 3
"""Runs of a list that have their picture, unless it is on the page already."""
_MAX_PICTURES, _MAX_PICTURE_BYTES = 40, 300_000
"""Pictures on a page, and size of each; larger ones are links."""
_MAX_GROUPS = 60
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1c2430; background: #fff; max-width: 70rem; margin: 2rem auto; padding: 0 1.2rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.2rem; border-top: 1px solid #d5dbe3; padding-top: 1rem } h3 { font-size: 1rem }
div.wide { overflow-x: auto; margin: .8rem 0 } table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { padding: .2rem .7rem; text-align: right; vertical-align: top; white-space: nowrap; border-bottom: 1px solid #e6eaef } th { color: #54606e; font-weight: 600 }
.text { text-align: left } .long { white-space: normal; min-width: 20rem; max-width: 34rem; overflow-wrap: break-word } svg { max-width: 100%; height: auto }
.better { color: #14713d } .worse { color: #b3261e } .note { color: #54606e } figure { display: inline-block; margin: .5rem .8rem .5rem 0 }
figure img { max-width: 20rem; max-height: 14rem; display: block } figcaption { color: #54606e; font-size: .85rem }
"""


def number(value: Any) -> str:
    """A number with the digits that a person reads."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "unknown"
    if isinstance(value, int):
        return str(value)
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], texts: Iterable[int] = (0,)) -> str:
    """A table; cells are HTML already. Columns ``texts`` hold texts, the others numbers."""
    wide = set(texts)

    def line(kind: str, cells: Sequence[str]) -> str:
        classes = (("text long" if len(cell) > _LONG and not cell.startswith("<") else "text") if index in wide else "number" for index, cell in enumerate(cells))
        return "".join(f'<{kind} class="{name}">{cell}</{kind}>' for name, cell in zip(classes, cells))

    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    names = line("th", [html.escape(name) for name in head])
    return f"<div class=wide><table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table></div>"


def _interval(summary: Summary) -> str:
    interval = summary.interval
    return number(interval.mean) if math.isnan(interval.half_width) else f"{number(interval.mean)} &plusmn; {number(interval.half_width)}"


def _summaries(summaries: Sequence[Summary], by: Sequence[str]) -> str:
    rows = []
    for one in summaries[:_MAX_GROUPS]:
        group = [html.escape(str(value)) for value in one.group] + [str(one.interval.count)]
        rows.append([*group, _interval(one), *(number(value) for value in (one.interval.deviation, one.low, one.median, one.high))])
    more = f"<p class=note>{len(summaries) - _MAX_GROUPS} more groups</p>" if len(summaries) > _MAX_GROUPS else ""
    head = [*by, "runs", "mean, 95 % interval", "deviation", "5 % below", "median", "95 % below"]
    return _table(head, rows, range(len(by))) + more


def _histogram(low: float, high: float, counts: Sequence[int]) -> str:
    """Bars of the number of runs over the value."""
    if not counts or low == high:
        return ""
    most, width, height = max(counts), 640, 120
    step = width / len(counts)
    bars = "".join(
        f'<rect x="{index * step:.1f}" y="{height - height * count / most:.1f}" width="{step - 1:.1f}" height="{height * count / most:.1f}"/>'
        for index, count in enumerate(counts)
        if count
    )
    ends = f'<text x="0" y="{height + 16}">{number(low)}</text><text x="{width}" y="{height + 16}" text-anchor="end">{number(high)}</text>'
    top = f'<text x="{width}" y="12" text-anchor="end" fill="#54606e">up to {most} runs</text>'
    return f'<svg viewBox="0 0 {width} {height + 20}" width="{width}" role="img" aria-label="runs by value" font-size="12"><g fill="#3b6ea8">{bars}</g>{ends}{top}</svg>'


def _link(page: Path, target: Path) -> str:
    return quote(os.path.relpath(target, page.parent))


class _Page:
    def __init__(self, page: Path, tables: Sequence[Table], measures: Sequence[str], by: Sequence[str], larger: Sequence[str], smaller: Sequence[str]) -> None:
        self.page, self.tables, self.measures, self.by = page, tables, measures, by
        self.larger, self.smaller = larger, smaller
        self.pictured: set[Path] = set()
        self.pairs: dict[str, Paired] = {}

    def head(self, table: Table) -> str:
        """What a study is, and how many of its runs are done."""
        request = read_json(table.folder / MARK) or {}
        statuses = table.statuses()
        counts = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
        values = [("graph", request.get("graph", "")), ("runs", counts)]
        values += [(f"hash of {name}", value) for name, value in sorted(request.get("hashes", {}).items())]
        values += [(name, json.dumps(swept)) for name, swept in request.get("sweep", {}).items()]
        return _table([table.folder.name, ""], [[html.escape(name), html.escape(str(value))] for name, value in values], (0, 1))

    def failures(self, table: Table) -> str:
        """Failed runs by their error."""
        errors = table.errors()
        if not errors:
            return ""
        store = Store(table.folder)
        rows = []
        for error, run, count in errors:
            link = _link(self.page, store.failed(run) / LOG)
            rows.append([str(count), f'<a href="{link}">{run}</a>', html.escape(error.splitlines()[0] if error else "")])
        return f"<h2>Failed runs of {html.escape(table.folder.name)}</h2>" + _table(["runs", "one of them", "error"], rows, (1, 2))

    def measure(self, name: str) -> str:
        """Numbers, distribution and worst runs of a measure; of the second study, where two are compared."""
        measure, is_larger = Measure(self.tables[-1], name, self.by), is_larger_better(name, self.larger, self.smaller)
        low, high, counts = measure.histogram()
        title = f"{name} of {self.tables[-1].folder.name}" if len(self.tables) == 2 else name
        parts = [f"<h2>{html.escape(title)}</h2>", _summaries([measure.summary()], ()), _histogram(low, high, counts)]
        if self.by:
            parts.append(_summaries(measure.groups(), self.by))
        if low < high:
            parts.append(f"<h3>Worst runs ({'less' if is_larger else 'more'} is worse)</h3>" + self.worst(measure, name, is_larger))
        if len(self.tables) == 2:
            parts.append(self.losses(name))
        return "".join(parts)

    def described(self, table: Table) -> list[str]:
        """Columns that say what a run was."""
        request = read_json(table.folder / MARK) or {}
        more = [*self.by, *request.get("columns", []), *request.get("sweep", {})]
        return list(dict.fromkeys(name for name in more if name in table.columns))

    def runs(self, table: Table, head: Sequence[str], rows: Sequence[tuple[dict[str, Any], Sequence[float]]]) -> str:
        """Rows of runs with links to their folders, some values, and what they were."""
        names, store = self.described(table), Store(table.folder)
        texts = [0, *(index for index, name in enumerate(names, 1 + len(head)) if any(isinstance(row[name], str) for row, _ in rows))]
        cells = [
            [f'<a href="{_link(self.page, store.run(row["run"]))}">{row["run"]}</a>', *map(number, values), *(html.escape(str(row[name])) for name in names)]
            for row, values in rows
        ]
        return _table(["run", *head, *names], cells, texts)

    def worst(self, measure: Measure, name: str, is_larger: bool) -> str:
        """Links to the worst runs, and their pictures."""
        table = self.tables[-1]
        rows = measure.worst(_WORST, is_larger, [*self.described(table), "files"])
        pictures = [self.picture(table, row, number(row["value"])) for row in rows[:_PICTURED]]
        return self.runs(table, [name], [(row, [row["value"]]) for row in rows]) + "".join(pictures)

    def losses(self, name: str) -> str:
        """The runs that are worse in the second study, side by side."""
        losses, (first, second) = self.pairs[name].losses, self.tables
        if not losses:
            return ""
        known = first.rows([position for position, _, _ in losses], ["run", *self.described(first), "files"])
        rows = [(known[position], [a, b, b - a]) for position, a, b in losses]
        pictures = []
        for row, (a, b, _) in rows[:_PICTURED]:
            shown = [self.picture(table, row, f"{table.folder.name}: {number(value)}") for table, value in ((first, a), (second, b))]
            pictures.append(f"<div>{''.join(shown)}</div>" if any(shown) else "")
        head = [first.folder.name, second.folder.name, "difference"]
        return "<h3>Runs that got worse</h3>" + self.runs(first, head, rows) + "".join(pictures)

    def picture(self, table: Table, row: dict[str, Any], caption: str) -> str:
        """The last picture that a run wrote; the other study has it under the same name."""
        of_run = [file for file in row.get("files") or [] if Path(file).suffix.lower() in _PICTURES]
        folder, run = Store(table.folder).run(row["run"]), f"{row['run']}, {html.escape(caption)}"
        if not of_run or folder in self.pictured or len(self.pictured) >= _MAX_PICTURES:
            return ""
        file = folder / of_run[-1]
        try:
            data = file.read_bytes() if file.stat().st_size <= _MAX_PICTURE_BYTES else b""
        except OSError:
            return ""
        if not data:
            return f'<figure><figcaption><a href="{_link(self.page, file)}">{html.escape(of_run[-1])}</a> of {run}</figcaption></figure>'
        self.pictured.add(folder)
        source = f"data:{_PICTURES[file.suffix.lower()]};base64,{base64.b64encode(data).decode()}"
        return f'<figure><a href="{_link(self.page, folder)}"><img src="{source}" alt="{html.escape(of_run[-1])}"></a><figcaption>{run}</figcaption></figure>'

    def comparison(self) -> str:
        """The runs that two studies have in common."""
        pairs = Pairs(*self.tables)
        rows = []
        for name in self.measures:
            is_larger = is_larger_better(name, self.larger, self.smaller)
            self.pairs[name] = pairs.compare(name, is_larger, _WORST)
            rows.append(_paired_row(self.pairs[name], is_larger))
        names = [html.escape(table.folder.name) for table in self.tables]
        head = ["measure", "pairs", *(table.folder.name for table in self.tables), "difference, 95 % interval", "runs that are better", "verdict"]
        text = (
            f"<p class=note>The same run of both studies is a pair: {names[1]} minus {names[0]}, mean and 95 % interval by Student's t over the runs. "
            "Each measure is compared by itself; of twenty measures without a difference one is expected to show one.</p>"
        )
        return f"<h2>{names[1]} compared with {names[0]}</h2>" + text + _table(head, rows, (0, 6))

    def render(self) -> str:
        """The whole page."""
        title = " and ".join(html.escape(table.folder.name) for table in self.tables)
        parts = [f"<h1>{title}</h1>", *(self.head(table) for table in self.tables)]
        if len(self.tables) == 2:
            parts.append(self.comparison())
        parts += [self.failures(table) for table in self.tables]
        parts += [self.measure(measure) for measure in self.measures]
        return f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title><style>{_STYLE}</style></head><body>{"".join(parts)}</body></html>\n'


def _paired_row(pair: Paired, is_larger: bool) -> list[str]:
    difference = pair.difference
    is_better = (difference.mean > 0) == is_larger
    verdict = "no difference shown"
    if difference.count >= 2 and pair.is_significant:
        verdict = f'<span class={"better" if is_better else "worse"}>{"better" if is_better else "worse"}</span>'
    return [
        html.escape(pair.measure), str(difference.count), number(pair.first_mean), number(pair.second_mean),
        f"{number(difference.mean)} &plusmn; {number(difference.half_width)}", f"{100 * pair.better_share:.1f} %", verdict,
    ]  # fmt: skip


def report(
    studies: Union[str, "os.PathLike[str]", Sequence[Union[str, "os.PathLike[str]"]]],
    html_file: Union[str, "os.PathLike[str]"],
    *,
    measures: Sequence[str] = (),
    by: Optional[Sequence[str]] = None,
    larger: Sequence[str] = (),
    smaller: Sequence[str] = (),
) -> Path:
    """Writes a page about one study of :func:`batch`, or about two that are compared run by run.

    ``measures`` are those to show, all without any. ``by`` are columns that runs are grouped by, without it the swept parameters. ``larger`` and
    ``smaller`` are measures of which more or less is better, where their names do not say it. Needs Polars.
    """
    folders = [studies] if isinstance(studies, (str, os.PathLike)) else list(studies)
    if not 1 <= len(folders) <= 2:
        raise StudyError(f"a report is about one study or two, not {len(folders)}")
    tables = [Table(Path(folder)) for folder in folders]
    shown = tables[0].checked(measures)
    if len(tables) == 2:
        shown = tables[1].checked(measures) if measures else [measure for measure in shown if measure in tables[1].measures]
        if not shown:
            raise StudyError(f"{folders[0]} and {folders[1]} have no measure in common")
    if by is None:
        by = [name for name in (read_json(tables[-1].folder / MARK) or {}).get("sweep", {}) if name in tables[-1].columns]
    unknown = [name for name in by if name not in tables[-1].columns]
    if unknown:
        raise StudyError(f"{tables[-1].folder} has no column `{unknown[0]}`; it has {', '.join(tables[-1].columns)}")
    page = Path(html_file)
    text = _Page(page, tables, shown, by, larger, smaller).render()
    part = page.with_name(f"{page.name}.{os.getpid()}.part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, page)
    return page
