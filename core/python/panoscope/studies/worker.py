"""One run of a study, on whatever machine: its process, its measures, its folder. All that crosses machines is a :class:`Task` and an outcome, both
plain objects of JSON."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any, Optional, TypedDict

import numpy as np

from .. import _native, installation
from ..columns import needed
from ..errors import PanoscopeError
from . import process
from .store import COMMAND, FILES, FILES_PLACE, INPUTS, LOG, RESULT, TICKS, Store, read_json, write_json
from .values import hash_of_inputs, stats, store_of

DONE, KEPT, FAILED, LOST, UNFIT = "done", "kept", "failed", "lost", "unfit"
"""Outcomes: lost runs are tried again, for a worker that is unfit another one takes its runs."""
STATISTICS = ("mean", "median", "min", "max", "deviation", "last", "count", "missing")
_SIGNALS = (-1, -2, -9, -15, 129, 130, 143)
"""How a run ends that was ended from outside: nothing is wrong with it."""
_MAX_ERROR = 2000


class Task(TypedDict):
    """What a worker needs for a run."""

    study: str
    """Folder of the study, which all workers reach."""
    key: str
    words: list[str]
    """The graph, its arguments, overlays and values."""
    inputs: list[str]
    """Files that are hashed."""
    written: dict[str, str]
    """Parameters that name what nodes write, and the paths below the run's folder."""
    hashes: dict[str, str]
    """Those of graph, plugins, models and request."""
    plugins: list[dict[str, Any]]
    """The plugins as the driver has them: name, file, xxh3."""
    folder: str
    """Installation of the driver."""
    measures: list[str]
    ticks: bool
    frames: Optional[int]
    threads: int
    max_s: float
    max_memory_mb: Optional[float]


class Outcome(TypedDict):
    """What became of a run."""

    key: str
    outcome: str
    error: str
    worker: str


def name() -> str:
    """This process, as messages name it."""
    here = f"process {os.getpid()} on {socket.gethostname()}"
    # Not imported: a process without it is no worker of Dask.
    dask = sys.modules.get("distributed")
    if dask is None:
        return here
    try:
        return f"{dask.get_worker().address} ({here})"
    except ValueError:
        return here


@lru_cache(maxsize=64)
def _unfit(folder: str, plugins: str) -> str:
    """Why this machine cannot do runs of a study; empty where it can."""
    try:
        here = installation.use().parent
    except PanoscopeError as error:
        return str(error)
    for plugin in json.loads(plugins):
        file = Path(plugin["file"])
        if file.is_relative_to(folder):
            file = here / file.relative_to(folder)
        own = _native.file_hash(file)
        if own != plugin["xxh3"]:
            what = "is another build than that of the driver" if own else "does not exist"
            return f"plugin `{plugin['name']}`: {file} {what}; install the same Panoscope on all machines"
    return ""


def _fetched(task: Task, scratch: Path) -> tuple[list[str], list[str]]:
    """Words and inputs of a run, with copies in place of what is in stores such as ``s3://``."""
    words, copies = [], dict[str, str]()
    for word in task["words"]:
        option, _, value = word.partition("=")
        name, _, address = value.partition("=")
        place = store_of(address) if option == "--graph-arg" else None
        if place is None:
            words.append(word)
            continue
        system, path = place
        local = scratch / "inputs" / name / path.rsplit("/", 1)[-1]
        local.parent.mkdir(parents=True, exist_ok=True)
        system.get(path, os.fspath(local), recursive=system.isdir(path))
        copies[address] = os.fspath(local)
        words.append(f"{option}={name}={local}")
    return words, [copies.get(path, path) for path in task["inputs"]]


def _statistics(values: Sequence[Optional[float]]) -> dict[str, Any]:
    """Those of one measure over the ticks of a run."""
    finite = np.array([value for value in values if value is not None], "f8")
    counts = {"count": len(finite), "missing": len(values) - len(finite)}
    if not len(finite):
        return {**dict.fromkeys(STATISTICS[:6]), **counts}
    numbers = (finite.mean(), np.median(finite), finite.min(), finite.max(), finite.std(), finite[-1])
    return {**dict(zip(STATISTICS, (float(number) for number in numbers))), **counts}


def _write_ticks(ticks: dict[str, Any], file: Path) -> None:
    """A row per tick: source, tick, capture_ns, and each measure."""
    arrow, parquet = needed("pyarrow", "a table of ticks"), needed("pyarrow.parquet", "a table of ticks")
    rows = ticks["rows"]
    columns = {name: arrow.array([row[index] for row in rows], arrow.int64()) for index, name in enumerate(("source", "tick", "capture_ns"))}
    for index, name in enumerate(ticks["columns"]):
        columns[name] = arrow.array([row[3][index] for row in rows], arrow.float64())
    parquet.write_table(arrow.table(columns), file)


def _error_of(ended: process.Ended, log: Path) -> str:
    """What a run that failed said, the errors if there are some."""
    if ended.limit:
        return ended.limit
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    errors = [line for line in lines if line.startswith("error")]
    said = "\n".join(errors or lines[-3:])[-_MAX_ERROR:]
    how = f"signal {-ended.code}" if ended.code < 0 else f"exit code {ended.code}"
    return f"{said} ({how})" if said else f"it ended with {how} and said nothing"


def _result(task: Task, report: dict[str, Any], hashes: dict[str, str], scratch: Path) -> dict[str, Any]:
    """The row of a run that is done; the same for the same hashes, so that it has no times."""
    ticks = report.pop("ticks", {"columns": [], "rows": []})
    measures = {column: _statistics([row[3][index] for row in ticks["rows"]]) for index, column in enumerate(ticks["columns"])}
    if task["ticks"]:
        _write_ticks(ticks, scratch / TICKS)
    files = scratch / FILES
    written = sorted(os.fspath(file.relative_to(scratch)) for file in files.rglob("*") if file.is_file() and not file.name.startswith(".")) if files.is_dir() else []
    failed_calls = sum(node.get("faults", 0) for node in report.get("nodes", {}).values())
    return {
        "key": task["key"], "status": DONE, "error": None, "hashes": hashes, "frames": report.get("frames"),
        "failed_calls": failed_calls, "measures": measures, "files": written,
    }  # fmt: skip


def _options(task: Task, files: str) -> list[str]:
    """Options that a run and its recording have; ``files`` is the folder that nodes write into."""
    options = ["--headless", "--unpaced", f"--threads={task['threads']}"]
    if task["frames"] is not None:
        options.append(f"--max-frames={task['frames']}")
    for param, path in sorted(task["written"].items()):
        options += ["--set", f"{param}={json.dumps(f'{files}/{path}')}"]
    return options


def _command(task: Task, words: Sequence[str], scratch: Path) -> list[str]:
    options = [*_options(task, os.fspath(scratch / FILES)), f"--report={scratch / 'report.json'}"]
    options += [f"--measure={measure}" for measure in task["measures"]]
    return [os.fspath(installation.use()), "run", *words, *options]


def _attempt(task: Task, store: Store, scratch: Path, slots: Optional[process.Slots]) -> Outcome:
    key, where = task["key"], name()

    def outcome(kind: str, error: str = "") -> Outcome:
        return {"key": key, "outcome": kind, "error": error, "worker": where}

    words, inputs = _fetched(task, scratch)
    hashes = {**task["hashes"], "inputs": hash_of_inputs(inputs)}
    facts = {"stats": stats(task["inputs"])}
    known = store.result(key)
    if known is not None and known["hashes"] == hashes:
        with store.replacing(store.run(key) / INPUTS) as file:
            write_json(file, facts)
        return outcome(KEPT)
    (scratch / FILES).mkdir()
    command = _command(task, words, scratch)
    with slots or nullcontext():
        ended = process.run(command, scratch / LOG, task["max_s"], task["max_memory_mb"])
    shutil.rmtree(scratch / "inputs", ignore_errors=True)
    attempt = {"worker": where, "seconds": ended.seconds, "cpu_s": ended.cpu_s, "peak_mb": ended.peak_mb}
    if ended.code in _SIGNALS and not ended.limit:
        return outcome(LOST, f"the run was ended from outside by signal {ended.code % 128 if ended.code > 0 else -ended.code}")
    write_json(scratch / "attempt.json", attempt)
    report = read_json(scratch / "report.json")
    if ended.code != 0 or ended.limit or report is None:
        error = _error_of(ended, scratch / LOG)
        write_json(scratch / RESULT, {"key": key, "status": FAILED, "error": error, "hashes": hashes})
        store.put(scratch, store.failed(key))
        store.discard(store.run(key))
        return outcome(FAILED, error)
    result = _result(task, report, hashes, scratch)
    write_json(scratch / "report.json", report)
    write_json(scratch / INPUTS, facts)
    write_json(scratch / COMMAND, {"words": [*task["words"], *_options(task, FILES_PLACE)]})
    write_json(scratch / RESULT, result)
    known = store.result(key)
    if known is None or known["hashes"] != hashes:
        store.put(scratch, store.run(key))
    store.discard(store.failed(key))
    return outcome(DONE)


def run(task: Task, slots: Optional[process.Slots] = None) -> Outcome:
    """Does a run, its process in one of the slots, and puts its folder in place. Raises nothing: what went wrong is in the outcome."""
    where = name()
    try:
        why = _unfit(task["folder"], json.dumps(task["plugins"]))
        if why:
            return {"key": task["key"], "outcome": UNFIT, "error": why, "worker": where}
        store = Store(Path(task["study"]))
        scratch = store.scratch(task["key"])
        try:
            return _attempt(task, store, scratch, slots)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except Exception as error:  # A full disk, a folder that is gone: another attempt may succeed, elsewhere too.
        return {"key": task["key"], "outcome": LOST, "error": f"{type(error).__name__}: {error}", "worker": where}


def is_known(task: Task, store: Store, is_exact: bool) -> bool:
    """Whether a run is done with these hashes, from what its folder says and from sizes and times of its inputs. Where these have changed their bytes
    are read if ``is_exact``, else it is left to the worker to find that they are the same."""
    known = store.result(task["key"])
    if known is None or any(known["hashes"].get(name) != value for name, value in task["hashes"].items()):
        return False
    facts = read_json(store.run(task["key"]) / INPUTS)
    if facts is not None and facts.get("stats") == stats(task["inputs"]):
        return True
    return is_exact and known["hashes"].get("inputs") == hash_of_inputs(task["inputs"])
