"""Graphs: checked, run, watched and changed while they run."""

from __future__ import annotations

import atexit
import json
import logging
import os
import weakref
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, cast

from . import _native, installation, pages
from .building import AnyNode, Arg, Draft, Output
from .catalogue import NodeTypes
from .errors import Diagnostic, EditError, GraphError, RunError
from .progress import Bar
from .series import Packet, Result

_LOG = logging.getLogger("panoscope")
_LEVELS = (logging.ERROR, logging.WARNING, logging.INFO, logging.DEBUG)
_PATIENCE_S = 30.0
"""How long nodes may take to finish after the end of a run."""
_POLL_S = 0.1
_running: weakref.WeakSet[Running] = weakref.WeakSet()


def word(value: Any) -> str:
    """A value as a command line has it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


def _json(value: Any) -> str:
    """A value of a parameter; numbers and arrays of NumPy are plain ones there."""

    def plain(other: Any) -> Any:
        if isinstance(other, os.PathLike):
            return os.fspath(other)
        if hasattr(other, "tolist"):
            return other.tolist()
        raise TypeError(f"a parameter cannot be a {type(other).__name__}")

    return json.dumps(value, default=plain)


def settings(values: Mapping[str, Any] | None) -> list[str]:
    """Values of parameters by ``node.param``, as the command's ``--set`` takes them."""
    # A text in JSON is one in TOML too, and so are numbers, flags and lists.
    return [f"{param}={_json(value)}" for param, value in (values or {}).items()]


class Running:
    """A graph that runs: iterate over the packets of the watched outputs, in the order in which they are made.

    ``with graph.start(watch=["scope.left"]) as running: ...`` ends it on leaving.
    """

    def __init__(self, native: Any, watch: list[str]) -> None:
        self.native = native
        self._watch = watch
        self._types = [partial(str, packet) for _, _, packet in native.watched()]
        self._closed: dict[str, Any] | None = None
        self._bar: Bar | None = None
        self._waiting: deque[Packet] = deque()
        """Packets that the native part gave, and nobody took yet."""
        _running.add(self)

    def __iter__(self) -> Iterator[Packet]:
        while True:
            while self._waiting:
                yield self._waiting.popleft()
            packets = self.native.poll(_POLL_S)
            self._log()
            if self._bar is not None and self._bar.is_due():
                self._bar.show(self.report["frames"])
            if packets is None:
                break
            for port, view, tick, age_ms in packets:
                self._waiting.append(Packet(self._watch[port], self._types[port], view, tick, age_ms))
        self.close()

    def _log(self) -> None:
        for level, node, words in self.native.log_lines():
            _LOG.log(_LEVELS[level], "%s: %s", node, words)

    def collect(self, bar: Bar | None = None) -> Result:
        """All packets until the run ends; ``bar`` shows how far it is."""
        result = Result(self._watch)
        self._bar = bar
        try:
            for packet in self:
                result.add(packet)
        finally:
            self.stop()
            if bar is not None:
                bar.close()
        result.sort()
        closed = self._close()
        result.faults, result.report = closed["faults"], closed["report"]
        return result

    def set(self, param: str, value: Any) -> str:
        """Sets ``node.param`` from the next tick on; returns what changed."""
        return str(self.native.set(param, _json(value)))

    def get(self, param: str) -> Any:
        """Value of ``node.param`` now."""
        return json.loads(self.native.get(param))

    def apply(self, text: str) -> str:
        """Makes the running graph the one of ``text``: checked, and done whole or not at all. Returns what changed."""
        return str(self.native.apply(text))

    @property
    def text(self) -> str:
        """Text of the running graph, in one piece."""
        return str(self.native.text())

    @property
    def report(self) -> dict[str, Any]:
        """Counters and times so far."""
        return cast(dict[str, Any], json.loads(self.native.report()))

    @property
    def dropped(self) -> int:
        """Packets of a live graph that nobody took in time."""
        return self._closed["dropped"] if self._closed else 0

    def _close(self) -> dict[str, Any]:
        if self._closed is not None:
            return self._closed
        closed: dict[str, Any] = json.loads(self.native.close(_PATIENCE_S))
        self._closed = closed
        self._log()
        return closed

    def stop(self) -> None:
        """Ends the run and completes its files. Packets that were not taken are lost."""
        self._close()

    def close(self) -> None:
        """As :meth:`stop`; raises :class:`RunError` if the run failed."""
        closed = self._close()
        faults = closed["faults"]
        failed = closed["failed"] or (closed["recorded"] or {}).get("failed")
        nodes = closed["report"].get("nodes", {})
        for node, counts in nodes.items():
            if not failed and counts["faults"] > 0 and counts["faults"] >= counts["count"]:
                failed = next((f"node `{node}` failed at every tick: {f['words']}" for f in reversed(faults) if f["node"] == node), None)
        if failed:
            raise RunError(failed, faults)

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


@atexit.register
def _stop_all() -> None:
    """Files are completed before the interpreter ends."""
    for running in list(_running):
        running.stop()


class Graph(NodeTypes):
    """A graph file: ``ps.Graph("depth.toml", args={"left": "left.mp4"}).run(frames=100, watch=["points.depth"])``.

    ``args`` are the graph's arguments, by name or as words of a command line (``["--left=left.mp4"]``); ``set`` are values of parameters by
    ``node.param``; ``overlays`` are files that replace nodes. A file that does not exist is looked for among the graphs of the installation, an
    overlay as ``sources/files.toml`` too.
    ``library`` is the folder of another installation's program and plugins.

    Without ``path`` the graph is built here, call by call::

        graph = ps.Graph(mode="batch")
        views = graph.capture(left="left.mp4", right="right.mp4")
        match = graph.stereo_bm(views.left, views.right, search_px=128)
        graph.run(frames=100, watch=[match.disparity])
        graph.save("own.toml")

    Each node type is a method; inputs come first, by position or name, then parameters by name. ``id`` names the node, else it has the name of
    its type. Relative paths start from the working folder. ``name``, ``mode`` and ``plugin_paths`` are those of the file that :meth:`save` writes.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        args: Mapping[str, Any] | Sequence[str] = (),
        *,
        set: Mapping[str, Any] | None = None,
        overlays: Sequence[str | os.PathLike[str]] = (),
        library: str | os.PathLike[str] | None = None,
        name: str | None = None,
        mode: str = "live",
        plugin_paths: Sequence[str | os.PathLike[str]] = (),
    ) -> None:
        installation.use(library)
        self.path = installation.graph_file(path) if path is not None else Path.cwd() / f"{name or 'graph'}.toml"
        """Of a graph that is built: what relative paths start from."""
        self._draft = Draft(self.path, name, mode, plugin_paths) if path is None else None
        self._args = args
        self._set = dict(set or {})
        self._overlays = [installation.graph_file(file) for file in overlays]
        self._record: tuple[Path, bool] | None = None
        self._running: Running | None = None
        self._opened: _native.GraphFile | None = None
        self._opened_version = 0
        if path is not None:
            self._opened = self._open()

    def _open(self) -> _native.GraphFile:
        named = [(name, word(value)) for name, value in self._args.items()] if isinstance(self._args, Mapping) else []
        words = [] if isinstance(self._args, Mapping) else [word(arg) for arg in self._args]
        text = None if self._draft is None else self._draft.text()
        return _native.GraphFile(self.path, words, named, settings(self._set), self._overlays, text)

    @property
    def native(self) -> _native.GraphFile:
        """The graph as the native part has it."""
        version = 0 if self._draft is None else self._draft.version
        if self._opened is None or version != self._opened_version:
            self._opened, self._opened_version = self._open(), version
        return self._opened

    @contextmanager
    def _at_calls(self) -> Iterator[None]:
        """Reports mistakes of a graph that is built at the calls that they come from."""
        try:
            yield
        except GraphError as error:
            if self._draft is None:
                raise
            raise self._draft.explained(error) from None

    def _built(self) -> Draft:
        if self._draft is None:
            raise GraphError(f"{self.path} is a file: change it with an editor, or build a graph with `ps.Graph()`")
        return self._draft

    def add(self, node_type: str | type, *inputs: Any, id: str | None = None, **values: Any) -> AnyNode:
        """Adds a node of any type, such as one of a plugin of your own: ``graph.add("my_filter", views.left, strength=2)``.

        ``node_type`` may also be a class with ``@ps.node``, of a notebook's cell too. It runs in a process of its own, with a copy of the functions,
        modules and plain values that it uses. :meth:`save` writes it next to the graph.
        """
        draft = self._built()
        name = draft.take(node_type) if isinstance(node_type, type) else node_type
        return draft.maker(name)(*inputs, id=id, **values)

    def part(self, file: str | os.PathLike[str], *, id: str | None = None, **values: Any) -> AnyNode:
        """Adds a part: a graph file with inputs, outputs and parameters."""
        return self._built().part(installation.graph_file(file), values, id)

    def arg(
        self,
        name: str,
        type: str = "text",
        *,
        default: Any = None,
        doc: str = "",
        unit: str = "",
        range: tuple[float, float] | None = None,
        choices: Sequence[str] | None = None,
    ) -> Arg:
        """Declares an argument, which stands wherever a value may stand: ``graph.capture(left=graph.arg("left", "source"))``."""
        return self._built().arg(name, {"type": type, "default": default, "doc": doc, "unit": unit, "range": range, "choices": choices})

    def output(self, reference: str) -> Output[Any]:
        """An output by its name, also of a node that is added later: ``graph.output("arm.joints").aligned(delay=1)``."""
        node, _, port = reference.rpartition(".")
        return Output(node, port)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the graph as a file, for the command and the editor; relative paths in it are made those of the file's folder."""
        file = Path(path)
        draft = self._built()
        with self._at_calls():
            self.native.check([], False)
        draft.write_classes(file.parent)
        file.write_text(draft.text(file.parent), encoding="utf-8")
        return file

    def words(self, folder: Path) -> list[str]:
        """The graph as words of a command line: the file, arguments, overlays and settings. A graph that is built is written into ``folder``."""
        path = self.path if self._draft is None else self.save(folder / "graph.toml")
        if isinstance(self._args, Mapping):
            # An option of the command may have an argument's name.
            args = [f"--graph-arg={name}={word(value)}" for name, value in self._args.items()]
        else:
            args = [word(arg) for arg in self._args]
        overlays = [text for file in self._overlays for text in ("--with", str(file))]
        return [str(path), *args, *overlays, *(text for setting in settings(self._set) for text in ("--set", setting))]

    def check(self) -> list[Diagnostic]:
        """Checks the whole graph; returns its warnings. Mistakes raise :class:`GraphError`."""
        with self._at_calls():
            return Diagnostic.list_of(self.native.check([], False))

    def start(
        self,
        watch: Sequence[str | Output[Any]] = (),
        *,
        frames: int | None = None,
        act: bool | None = None,
        paced: bool = True,
        threads: int = 0,
        keep_all: bool = False,
    ) -> Running:
        """Starts the graph; packets of the outputs in ``watch`` come from the returned :class:`Running`.

        With ``watch`` only the nodes that these outputs need run, so that nothing is written and nothing moves; ``act=True`` runs all nodes, as
        the command does. ``frames`` is the number of ticks that each source makes. Sources of a live graph wait for the capture time of their
        frames, unless ``paced`` is false. Of a live graph the newest packets are kept while nobody takes them, with ``keep_all`` its nodes wait.
        """
        if self._running is not None:
            self._running.stop()
        is_part = bool(watch) and not act
        if act is False and not watch:
            raise GraphError("without `watch` nothing needs to run: name the outputs to watch, or leave out `act`")
        file, all_ports = self._record or (None, False)
        names = [str(output) for output in watch]
        with self._at_calls():
            native = self.native.start(names, is_part, keep_all, frames, paced, threads, file, all_ports)
        self._running = Running(native, names)
        return self._running

    def run(
        self,
        frames: int | None = None,
        watch: Sequence[str | Output[Any]] = (),
        *,
        act: bool | None = None,
        paced: bool = False,
        threads: int = 0,
        progress: bool | None = None,
    ) -> Result:
        """Runs the graph to its end; ``result["points.depth"]`` has what the output gave. See :meth:`start`; here no packet is lost.

        ``progress`` shows or hides a bar; by default there is one in notebooks and on terminals.
        """
        running = self.start(watch, frames=frames, act=act, paced=paced, threads=threads, keep_all=True)
        try:
            return running.collect(Bar(self.name, frames, progress))
        finally:
            self._running = None

    def record(self, file: str | os.PathLike[str], *, all_ports: bool = False) -> Graph:
        """Records the next runs, each in place of the one before: the sources' outputs, or those of all nodes.

        Returns the graph, as in ``graph.record("a.mcap").run(100)``.
        """
        self._record = (Path(file), all_ports)
        return self

    def set(self, param: str, value: Any) -> None:
        """Sets ``node.param``: from the next tick on while the graph runs, and in later runs."""
        if self._running is not None:
            self._running.set(param, value)
        old = dict(self._set)
        self._set[param] = value
        try:
            self._opened = self._open()
        except GraphError:
            self._set = old
            raise

    def get(self, param: str) -> Any:
        """Value of ``node.param``."""
        if self._running is not None:
            return self._running.get(param)
        with self._at_calls():
            return json.loads(self.native.get(param))

    def apply(self, text: str) -> str:
        """Changes the running graph to the one of ``text``; see :meth:`Running.apply`."""
        if self._running is None:
            raise EditError("the graph does not run: start it first, or open the other graph")
        return self._running.apply(text)

    def stop(self) -> None:
        """Ends the run, if there is one."""
        running, self._running = self._running, None
        if running is not None:
            running.stop()

    @property
    def outputs(self) -> dict[str, str]:
        """All outputs that can be watched, with the names of their packet types."""
        with self._at_calls():
            return dict(self.native.outputs())

    @property
    def text(self) -> str:
        """Text of the running graph, or of the file."""
        return self._running.text if self._running is not None else self.native.text

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.native.name)

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _repr_html_(self) -> str:
        return pages.of_graph(self)

    def __repr__(self) -> str:
        return f"<graph {self.name}: {self.path if self._draft is None else 'built here'}>"


def check(path: str | os.PathLike[str], args: Mapping[str, Any] | Sequence[str] = (), **options: Any) -> list[Diagnostic]:
    """Checks a graph file and returns its warnings; mistakes raise :class:`GraphError` with place and remedy. Arguments as of :class:`Graph`.

    Plugins that the graph brings in its own folders are loaded, as for a run: check no graph of strangers.
    """
    return Graph(path, args, **options).check()
