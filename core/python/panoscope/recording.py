"""Recordings: read packet by packet, and played again."""

from __future__ import annotations

import os
import subprocess
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import installation, pages
from ._native import RecordingFile
from ._native import replay as _replay
from .errors import RecordingError
from .progress import Bar
from .series import Packet, Result, Series

if TYPE_CHECKING:
    from .building import Output
    from .graph import Graph


class Recording(Mapping[str, Series]):
    """A recording: ``ps.Recording("a.mcap")["scope.left"][10]``. Packets are read from the file when they are asked for."""

    def __init__(self, path: str | os.PathLike[str], *, trust_plugins: bool = True) -> None:
        """``trust_plugins=False`` loads no plugin from the folders that the recorded graph names; plain data of their nodes cannot be read then."""
        installation.use()
        self.path = Path(path)
        self.native = RecordingFile(self.path, trust_plugins)
        self._trust = ["--trust-plugins"] if trust_plugins else []
        self._counts = dict(self.native.ports())
        cut = self.native.cut()
        if cut:
            warnings.warn(f"{self.path} is not complete: {cut}", stacklevel=2)

    def __getitem__(self, output: str) -> Series:
        if output not in self._counts:
            raise KeyError(f"{self.path} has no packets of `{output}`; it has {', '.join(self._counts) or 'none'}")
        return Series(output, lambda index: self._packet(output, index), range(self._counts[output]))

    def _packet(self, output: str, index: int) -> Packet:
        read = self.native.read(output, index)
        if read is None:
            raise IndexError(index)
        view, tick = read
        return Packet(output, partial(self.native.packet, output), view, tick, float("nan"))

    def to_folder(self, path: str | os.PathLike[str], ports: Sequence[str] = (), *, force: bool = False) -> None:
        """Writes pictures as PNG, disparity and depth as NPY, clouds as PLY, calibrations as YAML, all others as CSV; ``panoscope export --folder``."""
        self._export("--folder", path, ports, force)

    def to_parquet(self, path: str | os.PathLike[str], ports: Sequence[str] = ()) -> list[Path]:
        """Writes a Parquet file into the folder ``path`` for each output without pixels, or of ``ports``; returns the files. Needs pyarrow."""
        folder = Path(path)
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for output in ports or self:
            series = self[output]
            if not ports and series.holds_arrays():
                continue
            files.append(folder / f"{output.replace('/', '.')}.parquet")
            series.to_parquet(files[-1])
        return files

    def to_foxglove(self, path: str | os.PathLike[str], ports: Sequence[str] = (), *, force: bool = False) -> None:
        """Writes an MCAP file with the schemas of Foxglove; ``panoscope export --foxglove``."""
        self._export("--foxglove", path, ports, force)

    def _export(self, target: str, path: str | os.PathLike[str], ports: Sequence[str], force: bool) -> None:
        words = [target, str(path), *(["--ports", ",".join(ports)] if ports else []), *(["--force"] if force else []), *self._trust]
        done = subprocess.run([installation.use(), "export", str(self.path), *words], capture_output=True, text=True)
        if done.returncode != 0:
            raise RecordingError(done.stderr.strip())

    def to_rerun(
        self,
        path: str | os.PathLike[str],
        ports: Sequence[str] = (),
        *,
        first_tick: int = 0,
        last_tick: int | None = None,
        force: bool = False,
    ) -> list[dict[str, Any]]:
        """Writes a file of rerun, see :mod:`panoscope.rerun_file`. Needs the package ``rerun-sdk``."""
        from .rerun_file import write

        return write(self, path, ports, first_tick, last_tick, force)

    def __iter__(self) -> Iterator[str]:
        return iter(self._counts)

    def __len__(self) -> int:
        return len(self._counts)

    def _repr_html_(self) -> str:
        return pages.table(["output", "packets"], list(self._counts.items()), len(self._counts))

    @property
    def graph_text(self) -> str:
        """The recorded graph as one text."""
        return self.native.graph()[1]

    def __repr__(self) -> str:
        return f"<recording {self.path}: " + ", ".join(f"{count} of {output}" for output, count in self._counts.items()) + ">"


def replay(
    recording: Recording | str | os.PathLike[str],
    watch: Sequence[str | Output[Any]] = (),
    *,
    graph: Graph | str | os.PathLike[str] | None = None,
    set: Mapping[str, Any] | None = None,
    frames: int | None = None,
    threads: int = 0,
    act: bool = False,
    record: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Result:
    """Plays a recording again to the byte, or another ``graph`` on its pictures. Nodes that write files or move things are left out unless ``act``.

    ``progress`` as of :meth:`Graph.run <panoscope.Graph.run>`.
    """
    from .graph import Graph, Running, settings

    recording = recording if isinstance(recording, Recording) else Recording(recording)
    graph = graph if graph is None or isinstance(graph, Graph) else Graph(graph)
    names = [str(output) for output in watch]
    native = _replay(
        recording.native,
        graph.native if graph else None,
        names,
        settings(set),
        frames,
        threads,
        act,
        Path(record) if record is not None else None,
    )
    return Running(native, names).collect(Bar(recording.path.name, frames, progress))
