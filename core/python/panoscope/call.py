"""What a node may ask and say while its ``process`` runs."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

_running = threading.local()


class _Running:
    """The call that runs on this thread."""

    def __init__(self, call: Any, ports: tuple[Any, ...]) -> None:
        self.call = call
        self.ports = ports


def begin(call: Any, ports: tuple[Any, ...]) -> None:
    """Remembers the call that begins on this thread, and the outputs of its node."""
    _running.now = _Running(call, ports)


def end() -> None:
    """Forgets it."""
    _running.now = None


def _now() -> _Running:
    now = getattr(_running, "now", None)
    if now is None:
        raise RuntimeError("this works only while the node's `process` runs, on its own thread")
    return now


def empty(shape: tuple[int, ...], dtype: Any = "u1", output: str | None = None) -> np.ndarray:
    """An array in the host's memory for an output: return it, and nothing is copied. Its contents are undefined.

    ``output`` names the output where the node has several.
    """
    now = _now()
    names = [port.name for port in now.ports]
    if output is None and len(names) == 1:
        output = names[0]
    if output not in names:
        raise ValueError(f"there is no output `{output}`; the outputs are {', '.join(names)}")
    index = names.index(output)
    kind = now.ports[index].kind
    allocate = getattr(kind, "allocate", None)
    array = allocate(now.call, index, tuple(shape), np.dtype(dtype)) if allocate else None
    if array is None:
        raise ValueError(f"output `{output}` of type `{kind.packet}` cannot be an array of {np.dtype(dtype)} of shape {tuple(shape)}")
    return array


def empty_like(image: np.ndarray, output: str | None = None) -> np.ndarray:
    """As :func:`empty`, with the shape and type of another array."""
    return empty(image.shape, image.dtype, output)


def tick() -> tuple[int, int, int]:
    """Source, number and capture time (ns of media time) of the tick."""
    return _now().call.tick()


def clock_ns() -> int:
    """The host's monotonic clock. What a node makes must not depend on it."""
    return _now().call.clock_ns()


def age_ms(input: int | None = None) -> float:
    """Age of the light of the tick, or of a frame by its position among all input frames, in ms; NaN where it is unknown."""
    return _now().call.age_ns(0xFFFF_FFFF if input is None else input) / 1e6


def metric(name: str, value: float) -> None:
    """A named number of the node, shown beside its timing."""
    _now().call.metric(name, float(value))


def log(message: str, level: str = "info") -> None:
    """A line for the host's log: ``error``, ``warn``, ``info`` or ``debug``."""
    levels = ("error", "warn", "info", "debug")
    _now().call.log(levels.index(level) + 1, str(message))
