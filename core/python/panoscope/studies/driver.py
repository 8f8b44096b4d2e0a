"""Runs a study: what is not done is handed to an executor, until everything is done or failed."""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Optional, Union, cast

from .. import installation
from ..errors import GraphError
from ..graph import Graph, word
from ..progress import Bar
from . import executors, table
from .plan import Run, arguments, inputs_of_words, rows_of, runs_of
from .store import LOG, MARK, RESULT, Store, StudyError, write_json
from .values import combinations, digest, number, params_of_words
from .worker import DONE, FAILED, KEPT, LOST, UNFIT, Outcome, Task, is_known

ATTEMPTS = 3
"""How often a run is tried that was ended from outside."""
_WAIT_S = 0.5
_LINE_S = 10.0
_MAX_CHECKED = 200
"""Combinations of swept values that are checked before anything runs."""
_MAX_TRIED = 20
"""Rows with which the graph is checked until it is right with one."""
AnyGraph = Union[Graph, str, "os.PathLike[str]"]


@dataclass
class Study:
    """A study after a call of :func:`batch`."""

    folder: Path
    runs: int
    counts: Counter[str] = field(default_factory=Counter)
    """Runs by what became of them in this call: ``done``, ``kept``, ``failed``; and ``open``."""
    failures: dict[str, str] = field(default_factory=dict)
    """Errors of failed runs, by their keys."""
    notes: list[str] = field(default_factory=list)
    """Workers that went, hung, or could not do the runs."""

    @property
    def table(self) -> Path:
        """The data set: ``runs.parquet``, ``ticks.parquet``, ``attempts.parquet``."""
        return self.folder / "table"

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {name}" for name, count in sorted(self.counts.items()))
        return f"<study {self.folder}: {self.runs} runs, {counts}>"


@dataclass
class _Plan:
    """What a study is asked to do."""

    runs: list[Run]
    tasks: dict[str, Task]
    request: dict[str, Any]
    hashes: dict[str, str]
    acting: list[str]
    """Nodes that do more than write files."""
    is_live: bool


def _redirected(written: Sequence[tuple[str, str]], folder: Path) -> dict[str, str]:
    """Paths in the folder of a run for what nodes write: those that the graph says, without ``..``; of a path outside of its folder the name."""
    found: dict[str, str] = {}
    for param, path in written:
        parts = Path(os.path.relpath(folder / path, folder)).parts if path else ()
        below = [part for part in parts if part != ".."]
        node = param.rpartition(".")[0].replace("/", "_")
        name = os.path.join(*(below[-1:] if os.path.isabs(path) and parts[:1] == ("..",) else below)) if below else node
        # Two nodes may write files of one name into different folders.
        found[param] = name if name not in found.values() else os.path.join(node, name)
    return found


def _first_right(words: Sequence[str], rows: Sequence[Run]) -> tuple[Run, dict[str, Any]]:
    """A run that the graph can be checked with, and what its results depend on: an input that is missing fails its own run, not the study."""
    first_error: Optional[GraphError] = None
    for run in rows[:_MAX_TRIED]:
        try:
            return run, json.loads(Graph(words[0], [*words[1:], *run.words]).native.provenance())
        except GraphError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def _plan(graph: Graph, inputs: Any, store: Store, sweep: Mapping[str, Any], options: Mapping[str, Any]) -> _Plan:
    """Reads the inputs, checks the graph with the first of them and every combination of values, and makes the tasks."""
    known, fixed = arguments(graph), options["args"]
    words = graph.words(store.folder)
    combined = combinations(sweep)
    runs = runs_of(rows_of(inputs, known), known, fixed, combined)
    fixed_words = [f"--graph-arg={name}={value}" for name, value in fixed.items()]
    first, facts = _first_right([*words, *fixed_words], runs[:: len(combined)])
    position = runs.index(first)
    for run in runs[position + 1 : position + min(len(combined), _MAX_CHECKED)]:
        Graph(words[0], [*words[1:], *fixed_words, *run.words]).check()
    named = {os.path.abspath(path) for path in first.inputs}
    models = [[model["name"], model["xxh3"]] for model in facts["models"] if os.path.abspath(model["file"]) not in named]
    request = {"words": [*words[1:], *fixed_words], "measures": options["measures"], "ticks": options["ticks"], "frames": options["frames"]}
    hashes = {
        "graph": digest([file["xxh3"] for file in facts["files"]]),
        "plugins": digest([facts["version"], *([plugin["name"], plugin["xxh3"]] for plugin in facts["plugins"])]),
        "models": digest(models),
        "request": digest(request),
    }
    common: dict[str, Any] = {
        "study": os.path.abspath(store.folder), "written": _redirected(facts["written"], Path(words[0]).resolve().parent), "hashes": hashes,
        "plugins": facts["plugins"], "folder": os.fspath(installation.use().parent),
        **{name: options[name] for name in ("measures", "ticks", "frames", "threads", "max_s", "max_memory_mb")},
    }  # fmt: skip
    head = [os.path.abspath(words[0]), *words[1:], *fixed_words]
    tasks = {run.key: cast(Task, {**common, "key": run.key, "words": [*head, *run.words], "inputs": run.inputs}) for run in runs}
    described = {
        **request, "graph": head[0], "sweep": {name: [run[name] for run in combined] for name in sweep}, "hashes": hashes, "runs": len(runs),
        "columns": list(dict.fromkeys(name for run in runs for name in run.columns)),
        "limits": {name: options[name] for name in ("max_s", "max_memory_mb")},
    }  # fmt: skip
    return _Plan(runs, tasks, described, hashes, facts["acting"], facts["is_live"])


class _Progress:
    """A bar on terminals and in notebooks, a line now and then elsewhere."""

    def __init__(self, name: str, total: int, wanted: Optional[bool], say: Callable[[str], None]) -> None:
        self._bar, self._say, self._next = Bar(name, total, wanted), say, time.monotonic() + _LINE_S
        self._has_lines = wanted is None and not sys.stderr.isatty()

    def show(self, done: int, failed: int) -> None:
        if self._bar.is_due():
            self._bar.show(done)
        if self._has_lines and time.monotonic() >= self._next:
            self._next = time.monotonic() + _LINE_S
            self._say(self._bar.text(done) + (f", {failed} failed" if failed else ""))

    def close(self) -> None:
        self._bar.close()


def _fail(store: Store, task: Task, error: str) -> None:
    """Notes a run as failed that left no folder."""
    scratch = store.scratch(task["key"])
    (scratch / LOG).write_text(error + "\n", encoding="utf-8")
    write_json(scratch / RESULT, {"key": task["key"], "status": FAILED, "error": error, "hashes": task["hashes"]})
    store.put(scratch, store.failed(task["key"]))


class _Drive:
    """Hands tasks to an executor until there are none."""

    def __init__(self, store: Store, study: Study, executor: executors.AnyExecutor, say: Callable[[str], None]) -> None:
        self._store, self._study, self._executor, self._say = store, study, executor, say
        self._attempts: Counter[str] = Counter()
        self._unfit: set[str] = set()

    def _note(self, text: str) -> None:
        self._study.notes.append(text)
        self._say(text)

    def _take(self, task: Task, outcome: Outcome) -> bool:
        """Counts what became of a run; whether it is over."""
        key, kind, error = task["key"], outcome["outcome"], outcome["error"]
        if kind == UNFIT:
            worker = outcome["worker"]
            is_first = worker not in self._unfit
            self._unfit.add(worker)
            if is_first:
                self._note(f"{worker} gets no more runs: {error}")
            if not self._executor.avoid(worker):
                raise StudyError(f"no worker can do the runs: {error}")
            self._attempts[key] += 1
            if self._attempts[key] <= ATTEMPTS * 10:
                return False
        elif kind == LOST:
            self._attempts[key] += 1
            if self._attempts[key] < ATTEMPTS:
                self._note(f"run {key} is tried again: {error}")
                return False
            error = f"tried {ATTEMPTS} times; the last time: {error}"
        if kind in (UNFIT, LOST):
            kind = FAILED
            _fail(self._store, task, error)
        self._study.counts[kind] += 1
        if kind == FAILED:
            self._study.failures[key] = error
            self._say(f"run {key} failed: {error.splitlines()[0]}")
        return True

    def run(self, tasks: Iterable[Task], progress: _Progress) -> None:
        """Runs all tasks."""
        waiting, pending, over = deque(tasks), dict[Any, Task](), 0
        while waiting or pending:
            while waiting and len(pending) < self._executor.window:
                task = waiting.popleft()
                pending[self._executor.submit(task)] = task
            for handle in self._executor.wait(pending, _WAIT_S):
                task = pending.pop(handle)
                try:
                    outcome = self._executor.outcome(handle)
                except Exception as error:  # Of the executor's own kind: a worker that died too often, a broken pool.
                    outcome = Outcome(key=task["key"], outcome=LOST, error=f"{type(error).__name__}: {error}", worker="?")
                if self._take(task, outcome):
                    over += 1
                else:
                    waiting.append(task)
            for note in self._executor.look():
                self._note(note)
            progress.show(over, self._study.counts[FAILED])


def _compact(plan: _Plan, store: Store, study: Study, has_ticks: bool) -> None:
    """Writes the data set of what is there."""
    rows = []
    study.failures = {}
    for position, run in enumerate(plan.runs, 1):
        result = store.result(run.key)
        if result is None or any(result["hashes"].get(name) != value for name, value in plan.hashes.items()):
            result = store.failure(run.key) or {}
        rows.append(table.row_of(run, position, result, plan.hashes))
        if result.get("status") == FAILED:
            study.failures[run.key] = str(result["error"])
    table.write_rows(rows, store, table.RUNS_FILE)
    table.write_attempts(plan.runs, store)
    table.write_ticks(plan.runs if has_ticks else [], store)


def _open_tasks(plan: _Plan, store: Store, retry: bool, is_exact: bool, study: Study) -> list[Task]:
    """The tasks that are neither done nor failed."""
    tasks = []
    for run in plan.runs:
        task = plan.tasks[run.key]
        failure = store.failure(run.key)
        if is_known(task, store, is_exact):
            study.counts[KEPT] += 1
        elif failure is not None and not retry and all(failure["hashes"].get(name) == value for name, value in plan.hashes.items()):
            study.counts[FAILED] += 1
        else:
            tasks.append(task)
    return tasks


def _warn(plan: _Plan, say: Callable[[str], None]) -> None:
    if plan.is_live:
        say("warning: the graph is live: which frames it drops depends on the machine, so that runs do not repeat; set mode = \"batch\"")
    if plan.acting:
        say(f"warning: {', '.join(plan.acting)} may act outside of the folder of a run, in each attempt")


def batch(
    graph: AnyGraph,
    inputs: Any,
    out: Union[str, "os.PathLike[str]"],
    *,
    executor: Any = None,
    sweep: Optional[Mapping[str, Any]] = None,
    args: Optional[Mapping[str, Any]] = None,
    measures: Sequence[str] = ("*",),
    ticks: bool = False,
    frames: Optional[int] = None,
    threads: Optional[int] = None,
    jobs: int = 1,
    max_s: float = 3600.0,
    max_memory_mb: Optional[float] = None,
    silent_s: float = 60.0,
    retry: bool = False,
    dry_run: bool = False,
    progress: Optional[bool] = None,
    say: Optional[Callable[[str], None]] = None,
) -> Study:
    """Runs a graph once for each row of ``inputs``, each run in a process with limits; goes on where an earlier call was stopped.

    ``inputs`` is a table (a CSV or Parquet file, rows, a table of pandas, Polars or Arrow) whose columns are arguments of the graph, ``node.param`` or
    descriptions; or patterns of files by argument, ``{"left": "{operation}/{clip}_left.mkv", "right": "{operation}/{clip}_right.mkv"}``, whose names
    are columns. ``sweep`` has values of parameters, of which all combinations are run for each row: a list, or (from, to, steps). ``args`` are
    arguments of all runs. ``measures`` are outputs with scalars or tables, ``node.output.column``, numbers that nodes report, or ``*``; ``ticks``
    keeps them per tick. ``frames`` is the maximum number of ticks of each source.

    ``executor`` is an executor of ``concurrent.futures``, a ``distributed.Client``, the module ``ray``, or the address of a scheduler; without it
    ``jobs`` runs go on at a time on this machine. A worker of Dask that says nothing for ``silent_s`` is taken out, its runs go to others. ``out`` is a folder that all workers reach under the same path, as are graph and inputs.

    A run is done when its folder is in place; one that is done is kept while the hashes of graph, plugins, models and inputs are the same. Failed runs
    hide no others: they have rows with their errors, and ``retry`` runs them again. ``dry_run`` only counts. ``say`` gets lines for people.
    """
    say = say or (lambda text: None)
    graph = graph if isinstance(graph, Graph) else Graph(graph)
    store = Store(Path(out))
    threads = threads or max((os.cpu_count() or 1) // max(jobs, 1), 1)
    options = {
        "args": dict(args or {}), "measures": list(measures), "ticks": ticks, "frames": frames, "threads": threads, "max_s": max_s,
        "max_memory_mb": max_memory_mb,
    }  # fmt: skip
    if not dry_run:
        store.folder.mkdir(parents=True, exist_ok=True)
    plan = _plan(graph, inputs, store, dict(sweep or {}), options)
    _warn(plan, say)
    study = Study(store.folder, len(plan.runs))
    if dry_run:
        tasks = _open_tasks(plan, store, retry, True, study)
        study.counts[table.OPEN] = len(tasks)
        for task in tasks:
            say(f"{task['key']}  {' '.join(task['words'])}")
        return study
    with store.lock():
        store.clean()
        with store.replacing(store.folder / MARK) as mark:
            write_json(mark, plan.request)
        tasks = _open_tasks(plan, store, retry, False, study)
        say(f"{len(plan.runs)} runs: {study.counts[KEPT]} are done, {study.counts[FAILED]} failed, {len(tasks)} to run")
        bar = _Progress(f"batch of {graph.name}", len(tasks), progress, say)
        where = executors.of(executor, jobs, max_s, silent_s)
        try:
            _Drive(store, study, where, say).run(tasks, bar)
        finally:
            where.close()
            bar.close()
            study.counts[table.OPEN] = len(plan.runs) - sum(study.counts[kind] for kind in (DONE, KEPT, FAILED))
            _compact(plan, store, study, ticks)
    return study


def of_words(request: Mapping[str, Any], say: Callable[[str], None]) -> Study:
    """The study that the command asks for."""

    def pairs(words: Iterable[str], option: str) -> dict[str, Any]:
        split = [text.partition("=") for text in words]
        wrong = next((name for name, separator, _ in split if not separator), None)
        if wrong is not None:
            raise StudyError(f"{option} {wrong}: write it as NAME=VALUE")
        return {name: value for name, _, value in split}

    settings = {name: number(value) for name, value in pairs(request["set"], "--set").items()}
    graph = Graph(request["graph"], set=settings, overlays=request["with"])
    executor = request["dask"] or (f"ray:{request['ray']}" if request["ray"] else None)
    return batch(
        graph,
        inputs_of_words(request["inputs"], arguments(graph)),
        request["output"],
        executor=executor,
        sweep=params_of_words(request["param"]),
        args={name: word(value) for name, value in pairs(request["arg"], "--arg").items()},
        measures=request["measure"] or ["*"],
        ticks=request["ticks"],
        frames=request["frames"],
        threads=request["threads"],
        jobs=request["jobs"],
        max_s=request["max_s"],
        max_memory_mb=request["max_memory_mb"],
        retry=request["retry"],
        dry_run=request["dry_run"],
        say=say,
    )
