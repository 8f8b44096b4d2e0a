"""Runs of a graph with other values of its parameters."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from . import installation
from .building import Output
from .columns import Rows, read_table
from .errors import GraphError, RunError
from .graph import Graph, word
from .progress import Bar


def _values(values: Any) -> str:
    """Values of a parameter as ``--param`` takes them."""
    if isinstance(values, range):
        values = list(values)
    if isinstance(values, tuple):
        if len(values) not in (2, 3):
            raise TypeError(f"{values!r}: a range is (from, to) or (from, to, steps); a list has the values themselves")
        return f"{values[0]}..{values[1]}" + (f"/{values[2]}" if len(values) == 3 else "")
    if isinstance(values, list):
        return ",".join(word(value) for value in values)
    raise TypeError(f"{values!r}: give a list of values, a range (from, to, steps), or None for the whole range")


def _run(command: list[str], table: Path, bar: Bar) -> None:
    """Runs the command; its lines, ``3 of 9: ...``, say how far it is."""
    words = []
    with subprocess.Popen([installation.use(), "sweep", *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            words.append(line)
            run = re.match(r"(\d+) of (\d+): ", line)
            if run is not None:
                bar.total = int(run[2])
                bar.show(int(run[1]))
    bar.close()
    if not table.exists():
        raise (RunError if process.returncode == 1 else GraphError)("".join(words).strip())


def sweep(
    graph: Graph | str | os.PathLike[str],
    params: str | Mapping[str, Any],
    measure: str | Output[Any] | Sequence[str | Output[Any]],
    *,
    start: float | None = None,
    stop: float | None = None,
    steps: int = 9,
    frames: int = 100,
    random: int | None = None,
    search: int | None = None,
    seed: int = 1,
    statistic: str = "mean",
    maximize: bool = False,
    jobs: int = 1,
    out: str | os.PathLike[str] | None = None,
    recording: str | os.PathLike[str] | None = None,
    threads: int = 0,
    progress: bool | None = None,
) -> Rows:
    """What parameters and node types do to measures, by ``panoscope sweep``.

    ``params`` is one parameter, with ``start``, ``stop`` and ``steps``; or several with their values, of which all combinations are run:
    ``{"match.type": ["stereo_bm", "stereo_sgbm"], "wls.lambda": (50, 800, 5), "match.subpixel": None}``. ``random`` makes so many runs with
    values drawn at random, ``search`` so many that each improve on ``statistic`` of the first measure. ``out`` is a folder for graph, hashes and
    results of each run, for ``panoscope report``.

    ``measure`` is a scalar output, a column of a table (``node.table.column``) or a number that a node reports; see ``panoscope sweep --help``.

    ``progress`` shows or hides a bar; by default there is one in notebooks and on terminals.

    Returns a row per run, also as a table: ``.to_pandas()``, ``.to_parquet(path)``. Of a single parameter it has ``value``, ``mean``, ``median``, ``min``, ``max``, ...; of several the value of each
    parameter by its name, and ``"<measure> mean"``, ...
    """
    graph = graph if isinstance(graph, Graph) else Graph(graph)
    measures = [str(name) for name in ([measure] if isinstance(measure, (str, Output)) else measure)]
    options = (
        ("--from", start), ("--to", stop), ("--steps", steps), ("--frames", frames), ("--recording", recording), ("--threads", threads or None),
        ("--random", random), ("--search", search), ("--out", out),
    )  # fmt: skip
    words = [*(f"--measure={name}" for name in measures)]
    words += [f"{name}={word(value)}" for name, value in options if value is not None]
    is_study = not isinstance(params, str) or len(measures) > 1 or jobs > 1 or any(option is not None for option in (random, search, out))
    bar = Bar(f"sweep of {graph.name}", None, progress)
    with tempfile.TemporaryDirectory(prefix="panoscope-") as folder:
        words = [*graph.words(Path(folder)), *words]
        if isinstance(params, str) and not is_study:
            table = Path(folder) / "sweep.json"
            _run([*words, f"--param={params}", f"--json={table}"], table, bar)
        else:
            table = Path(folder) / "sweep.csv"
            named = {params: None} if isinstance(params, str) else params
            words += [f"--param={name}" if values is None else f"--param={name}={_values(values)}" for name, values in named.items()]
            words += [f"--random-seed={seed}", f"--statistic={statistic}", f"--jobs={jobs}", *(["--maximize"] if maximize else [])]
            _run([*words, f"--csv={table}"], table, bar)
        return read_table(table)
