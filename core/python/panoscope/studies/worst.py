"""The worst runs of a study, and recordings of them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Optional, Union

from .. import installation
from ..columns import Rows
from . import process
from .statistics import Measure, Table, is_larger_better
from .store import COMMAND, FILES_PLACE, MARK, Store, StudyError, read_json

FOLDER = "worst"


def _record(folder: Path, run: str) -> str:
    """Runs a run again as a recording of all outputs; returns its file."""
    store = Store(folder)
    command = (read_json(store.run(run) / COMMAND) or {}).get("words")
    if not command:
        raise StudyError(f"{store.run(run)} does not say how it was run: run the study again")
    place = folder / FOLDER
    place.mkdir(exist_ok=True)
    file, part = place / f"{run}.mcap", place / f".{run}.{os.getpid()}.mcap"
    log = place / f"{run}.log"
    request = read_json(folder / MARK) or {}
    words = [word.replace(FILES_PLACE, os.fspath(place / run)) for word in command]
    limits = request.get("limits", {})
    try:
        words = [os.fspath(installation.use()), "record", *words, "--all-ports", "-o", os.fspath(part)]
        ended = process.run(words, log, limits.get("max_s") or 3600.0, limits.get("max_memory_mb"))
        if ended.code != 0 or ended.limit:
            raise StudyError(f"run {run} was not recorded: {ended.limit or f'exit code {ended.code}'}; see {log}")
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)
    return os.fspath(file)


def worst(
    study: Union[str, "os.PathLike[str]"],
    measure: str,
    n: int = 20,
    *,
    larger: Optional[bool] = None,
    record: bool = False,
) -> Rows:
    """The ``n`` runs of a study whose mean of a measure is worst, the worst first: run, value, columns of the input, folder.

    ``larger`` says that more is better, where the measure's name does not. ``record`` runs them again and records all outputs of all nodes, for
    ``panoscope edit`` and ``panoscope replay``: column ``recording``.
    """
    folder = Path(study)
    table = Table(folder)
    table.checked([measure])
    is_larger = is_larger_better(measure) if larger is None else larger
    request = read_json(folder / MARK) or {}
    rows = Rows(Measure(table, measure).worst(n, is_larger, [*request.get("columns", []), *request.get("sweep", {})]))
    for row in rows:
        row["folder"] = os.fspath(Store(folder).run(row["run"]))
        if record:
            row["recording"] = _record(folder, row["run"])
    return rows
