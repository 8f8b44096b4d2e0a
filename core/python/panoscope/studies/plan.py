"""Which runs a study has: a row of a table, or a group of files, with values of parameters."""

from __future__ import annotations

import csv
import glob
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from ..columns import needed
from ..graph import Graph, settings, word
from .store import StudyError
from .values import digest, number

Row = dict[str, Any]
_FILE_KINDS = ("source", "file", "path")
_VIEWS = ("left", "right")
HASHES = tuple(f"{name}_hash" for name in ("graph", "plugins", "models", "request", "inputs"))
OWN_COLUMNS = ("run", "number", "status", "error", *HASHES, "frames", "failed_calls", "files")
"""Of the table of runs, besides columns of the inputs, swept parameters and measures."""
_MAX_NAMED = 5
"""Rows, files or names that an error lists."""


@dataclass(frozen=True)
class Run:
    """One run: the same inputs and values have the same key, in whatever row they stand."""

    key: str
    columns: Row
    """Its row of the table."""
    params: Row
    """Values of swept parameters."""
    words: list[str]
    """What its command line has besides that of the study."""
    inputs: list[str]
    """Paths among the arguments."""


@dataclass(frozen=True)
class Argument:
    """An argument of the graph."""

    name: str
    kind: str
    is_missing: bool
    """It has neither a default nor a value for all runs."""


def arguments(graph: Graph) -> list[Argument]:
    """The arguments that a graph declares."""
    return [Argument(name, kind, missing) for name, kind, _, missing in graph.native.arguments()]


def _listed(names: Iterable[Any]) -> str:
    """The first of many names."""
    every = [str(name) for name in names]
    more = f" and {len(every) - _MAX_NAMED} more" if len(every) > _MAX_NAMED else ""
    return ", ".join(every[:_MAX_NAMED]) + more


def _is_address(text: str) -> bool:
    return re.match(r"[a-z][a-z0-9+.-]*://", text, re.IGNORECASE) is not None


def _regex(pattern: str) -> tuple[str, str]:
    """The pattern for ``glob``, and as a regular expression."""
    regex, wild, names = "", "", set()
    for part in re.split(r"(\{\w+\}|\*\*/|\*|\?)", pattern):
        name = part[1:-1] if part.startswith("{") else ""
        if name:
            regex += f"(?P={name})" if name in names else f"(?P<{name}>[^/]+?)"
            wild += "*"
            names.add(name)
        elif part in ("**/", "*", "?"):
            regex += {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}[part]
            wild += part
        else:
            regex += re.escape(part)
            wild += glob.escape(part)
    return wild, regex


def _files(pattern: str) -> list[tuple[str, Row]]:
    """The files of a pattern, each with the values of its names."""
    wild, regex = _regex(pattern)
    if _is_address(pattern):
        system, path = needed("fsspec.core", f"the address {pattern}").url_to_fs(wild)
        scheme = pattern.split("://", 1)[0]
        found, regex = sorted(f"{scheme}://{file}" for file in system.glob(path)), regex.replace(re.escape("://"), ":///*", 1)
    else:
        found = sorted(glob.glob(wild, recursive=True))
    matches = ((file, re.fullmatch(regex, file)) for file in found)
    return [(file, match.groupdict()) for file, match in matches if match]


def of_patterns(patterns: Mapping[str, str]) -> list[Row]:
    """A row for each combination of names for which every argument has a file."""
    found: dict[tuple[Any, ...], Row] = {}
    columns: Optional[list[str]] = None
    for argument, pattern in patterns.items():
        files = _files(pattern)
        if not files:
            raise StudyError(f"{argument}: no file is named like {pattern}")
        names = sorted(files[0][1])
        if columns is not None and names != columns:
            raise StudyError(f"{argument}: {pattern} has the names {_listed(names) or 'none'}, another pattern {_listed(columns) or 'none'}: they must be the same")
        columns = names
        for file, values in files:
            row = found.setdefault(tuple(values[name] for name in names), dict(values))
            if argument in row:
                raise StudyError(f"{argument}: {row[argument]} and {file} have the same names: write another {{name}} where they differ")
            row[argument] = file
    lonely = [row for row in found.values() if not all(argument in row for argument in patterns)]
    if lonely:
        files = [row[argument] for row in lonely for argument in patterns if argument in row]
        raise StudyError(f"{len(lonely)} files have no partner: {_listed(files)}; give the files of both views, or a table of those to run")
    return [found[key] for key in sorted(found)]


def _of_pattern(pattern: str, known: Sequence[Argument]) -> list[Row]:
    """One pattern without an argument: of the only one that is missing, or of both views where it has the word ``left``."""
    wanted = [argument.name for argument in known if argument.is_missing and argument.kind in _FILE_KINDS]
    folder, name = os.path.split(pattern)
    views = [view for view in _VIEWS if re.search(rf"(?<![a-z]){view}(?![a-z])", re.sub(r"\{\w+\}", "{}", name))]
    if set(_VIEWS) <= {argument.name for argument in known} and len(views) == 1:
        here = views[0]
        partner = {view: os.path.join(folder, re.sub(rf"(?<![a-z{{]){here}(?![a-z}}])", view, name)) for view in _VIEWS}
        return of_patterns(partner)
    if len(wanted) != 1:
        names = _listed(wanted or (argument.name for argument in known)) or "none"
        raise StudyError(f"{pattern}: say which argument its files are, as in NAME={pattern}; the graph has the arguments {names}")
    return of_patterns({wanted[0]: pattern})


def _of_file(file: Path) -> list[Row]:
    if file.suffix.lower() == ".parquet":
        rows: list[Row] = needed("pyarrow.parquet", "a table in Parquet").read_table(file).to_pylist()
        return rows
    with file.open(newline="", encoding="utf-8-sig") as stream:
        return [{name: value for name, value in row.items() if name} for row in csv.DictReader(stream)]


def rows_of(inputs: Any, known: Sequence[Argument]) -> list[Row]:
    """Rows of a table (a CSV or Parquet file, a list of rows, a table of pandas, Polars or Arrow), or those of patterns by argument."""
    if isinstance(inputs, (str, os.PathLike)):
        text = os.fspath(inputs)
        if Path(text).suffix.lower() in (".csv", ".parquet") and "{" not in text and "*" not in text:
            if not Path(text).is_file():
                raise StudyError(f"{text} does not exist")
            return _of_file(Path(text))
        return _of_pattern(text, known)
    if isinstance(inputs, Mapping):
        return of_patterns({name: os.fspath(pattern) for name, pattern in inputs.items()})
    for method in ("to_pylist", "to_dicts"):
        if hasattr(inputs, method):
            return list(getattr(inputs, method)())
    if hasattr(inputs, "to_dict"):
        return list(inputs.to_dict("records"))
    return [dict(row) for row in inputs]


def inputs_of_words(words: Sequence[str], known: Sequence[Argument]) -> Any:
    """``--inputs`` of the command: one table or pattern, or ARGUMENT=PATTERN for several arguments."""
    names = {argument.name for argument in known}
    pairs = [word.partition("=") for word in words]
    if all(separator and name in names for name, separator, _ in pairs):
        return {name: pattern for name, _, pattern in pairs}
    if len(words) != 1:
        wrong = next(name if separator else word for word, (name, separator, _) in zip(words, pairs) if name not in names)
        raise StudyError(f"--inputs {wrong}: of several patterns each is ARGUMENT=PATTERN; the graph has the arguments {_listed(sorted(names)) or 'none'}")
    return words[0]


def _absolute(kind: str, text: str) -> str:
    """A path that a worker with another working folder reads, too."""
    if kind not in _FILE_KINDS or not text or _is_address(text):
        return text
    path = Path(text)
    is_path = kind != "source" or path.exists() or ("/" in text and path.parent.is_dir()) or re.search(r"[*%]", text)
    return os.path.abspath(text) if is_path else text


def _checked_columns(rows: Sequence[Row], known: Sequence[Argument], fixed: Mapping[str, Any]) -> None:
    """Every argument that must be given is given in every row."""
    if not rows:
        raise StudyError("there is no input")
    columns = set().union(*rows)
    own = sorted(columns & set(OWN_COLUMNS))
    if own:
        raise StudyError(f"`{own[0]}` is a column that results have: give that of the table another name")
    missing = [argument.name for argument in known if argument.is_missing and argument.name not in columns and argument.name not in fixed]
    if missing:
        names = ", ".join(missing)
        raise StudyError(f"the graph needs the arguments {names}: the table has the columns {_listed(sorted(columns)) or 'none'}; add them, or give --arg {missing[0]}=VALUE")
    twice = sorted(columns & set(fixed))
    if twice:
        raise StudyError(f"`{twice[0]}` is a column of the table and has a value for all runs: leave one of them out")
    for argument in known:
        empty = [str(number) for number, row in enumerate(rows, 1) if argument.is_missing and argument.name in columns and row.get(argument.name) in (None, "")]
        if empty:
            raise StudyError(f"`{argument.name}` is empty in rows {_listed(empty)}")


def runs_of(rows: Sequence[Row], known: Sequence[Argument], fixed: Mapping[str, Any], sweep: Sequence[Row]) -> list[Run]:
    """All runs of a study, in the order of the table. Columns that are neither arguments nor ``node.param`` only describe a run."""
    _checked_columns(rows, known, fixed)
    kinds = {argument.name: argument.kind for argument in known}
    runs: list[Run] = []
    first: dict[str, int] = {}
    for position, row in enumerate(rows, 1):
        args = {name: word(value) for name, value in row.items() if name in kinds and value not in (None, "")}
        own = {name: number(value) if isinstance(value, str) else value for name, value in row.items() if "." in name and value not in (None, "")}
        paths = {name: _absolute(kinds[name], value) for name, value in sorted(args.items())}
        words = [f"--graph-arg={name}={value}" for name, value in paths.items()]
        inputs = [value for name, value in paths.items() if kinds[name] in ("source", "file")]
        for params in sweep:
            key = digest({"args": args, "params": {**own, **params}})[:16]
            if first.setdefault(key, position) != position:
                raise StudyError(f"rows {first[key]} and {position} are the same run: leave one of them out")
            values = [text for setting in settings({**own, **params}) for text in ("--set", setting)]
            runs.append(Run(key, row, params, words + values, inputs))
    return runs
