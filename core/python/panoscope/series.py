"""Packets of an output, in order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Callable

import numpy as np

from . import pages
from .columns import Columns, Rows, of_packets, rows_of_report
from .packets import BYTES, decode
from .pictures import png
from .sliders import slider


class Packet:
    """What an output gave at one tick."""

    __slots__ = ("age_ms", "capture_ns", "output", "packet_type", "source", "tick", "value", "_view")

    def __init__(self, output: str, packet_type: Callable[[], str], view: Any, tick: tuple[int, int, int], age_ms: float) -> None:
        self.output = output
        """As it was named in ``watch``, or in the recording."""
        self.source, self.tick, self.capture_ns = tick
        self.age_ms = age_ms
        """Time from the arrival of the light until the packet was made, in ms; NaN where it is not known."""
        self.packet_type = packet_type
        """Name of its packet type, such as ``depth``; of pixels in recordings it is looked up when it is asked for."""
        self.value = decode(view, packet_type() if view.format == BYTES else "")
        """An array, a record, a number or a text, as a node in Python would get it."""
        self._view = view

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the bytes, the same as in ``panoscope record --digests``."""
        return f"{self._view.fingerprint():016x}"

    def _repr_html_(self) -> str:
        return pages.of_packet(self)

    def _repr_png_(self) -> bytes | None:
        return png(self.value) if isinstance(self.value, np.ndarray) else None

    def __repr__(self) -> str:
        value = f"{self.value.dtype} {self.value.shape}" if isinstance(self.value, np.ndarray) else repr(self.value)
        return f"<{self.output} at tick {self.tick}: {value}>"


class Series(Sequence[Any], Columns):
    """Values of an output in the order of their ticks. ``series[3]`` is a value, ``series[10:20]`` a part, ``np.asarray(series)`` all in one array."""

    def __init__(self, output: str, packet: Callable[[int], Packet], indices: Sequence[int]) -> None:
        self.output = output
        self._packet = packet
        self._indices = indices

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return Series(self.output, self._packet, self._indices[index])
        return self.packet(index).value

    def holds_arrays(self) -> bool:
        """Whether its values are pixels or points."""
        return len(self) > 0 and isinstance(self[0], np.ndarray)

    def packet(self, index: int) -> Packet:
        """A value with its tick and age."""
        return self._packet(self._indices[index])

    def packets(self) -> Iterator[Packet]:
        """All values with their ticks and ages."""
        return (self._packet(index) for index in self._indices)

    @property
    def ticks(self) -> np.ndarray:
        """Number of each value's tick."""
        return np.array([packet.tick for packet in self.packets()], "i8")

    @property
    def capture_ns(self) -> np.ndarray:
        """Capture time of each value, media time in ns."""
        return np.array([packet.capture_ns for packet in self.packets()], "i8")

    @property
    def ages_ms(self) -> np.ndarray:
        """Age of each value when it was made, in ms."""
        return np.array([packet.age_ms for packet in self.packets()], "f8")

    def columns(self) -> dict[str, list[Any]]:
        """Columns ``tick``, ``capture_ns``, ``age_ms`` and those of the values: a row for each value, each row of a table, each box."""
        return of_packets(self.packets())

    def stack(self) -> np.ndarray:
        """All values in one array; its first axis is the tick."""
        values = list(self)
        shapes = {np.shape(value) for value in values}
        if len(shapes) > 1:
            raise ValueError(f"the values of `{self.output}` have different shapes: {sorted(shapes)}")
        return np.stack(values) if values else np.empty(0)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        stacked = self.stack()
        return stacked if dtype is None else stacked.astype(dtype)

    def __repr__(self) -> str:
        return f"<{self.output}: {len(self)} values>"

    def _repr_html_(self) -> str:
        return pages.of_series(self)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """Thumbnails, and where ipywidgets is there a slider over all packets."""
        bundle = {"text/plain": repr(self), "text/html": self._repr_html_()}
        return {**bundle, **(slider(self) if len(self) > 1 and self.holds_arrays() else {})}


class Result(Mapping[str, Series], Columns):
    """What a run gave: ``result["points.depth"]`` is the :class:`Series` of a watched output."""

    def __init__(self, watch: Sequence[str]) -> None:
        self._packets: dict[str, list[Packet]] = {output: [] for output in watch}
        self.faults: list[dict[str, Any]] = []
        """Faults of nodes: ``node``, ``cause``, ``words``, ``seq``, ..."""
        self.report: dict[str, Any] = {}
        """Counters and times, as ``panoscope run --report`` writes them."""

    def add(self, packet: Packet) -> None:
        """Appends a packet."""
        self._packets[packet.output].append(packet)

    def sort(self) -> None:
        """Puts the packets into the order of their ticks."""
        for packets in self._packets.values():
            packets.sort(key=lambda packet: (packet.capture_ns, packet.source, packet.tick))

    def __getitem__(self, output: Any) -> Series:
        output = str(output)
        packets = self._packets[output]
        return Series(output, packets.__getitem__, range(len(packets)))

    def columns(self) -> dict[str, list[Any]]:
        """The columns of all outputs without pixels, one below the other; column ``output`` names them."""
        parts = [(output, series.columns()) for output, series in self.items() if not series.holds_arrays()]
        names = dict.fromkeys(name for _, columns in parts for name in columns)
        whole: dict[str, list[Any]] = {"output": [], **{name: [] for name in names}}
        for output, columns in parts:
            count = len(columns["tick"])
            whole["output"] += [output] * count
            for name in names:
                whole[name] += columns.get(name, [None] * count)
        return whole

    def nodes(self) -> Rows:
        """A row for each node: times, counts, drops, faults."""
        return rows_of_report(self.report)

    def __iter__(self) -> Iterator[str]:
        return iter(self._packets)

    def __len__(self) -> int:
        return len(self._packets)

    def __repr__(self) -> str:
        return "<result: " + ", ".join(f"{len(packets)} of {output}" for output, packets in self._packets.items()) + ">"

    def _repr_html_(self) -> str:
        return pages.of_result(self)
