"""What a node may ask and say while its ``process`` runs."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np

_running = threading.local()


class Outputs:
    """The outputs of an instance, and what its running call made of them."""

    def __init__(self, ports: tuple[Any, ...]) -> None:
        self.ports = ports
        self.index = {port.name: index for index, port in enumerate(ports)}
        self.call: Any = None
        self.made: dict[int, np.ndarray] = {}
        """Arrays in the host's memory."""


def begin(outputs: Outputs, call: Any) -> None:
    """Remembers the call that begins on this thread."""
    outputs.call = call
    _running.now = outputs


def end(outputs: Outputs) -> None:
    """Forgets it. Arrays that nobody else has are gone before the call ends."""
    outputs.made.clear()
    _running.now = None


def _now() -> Outputs:
    now = getattr(_running, "now", None)
    if now is None:
        raise RuntimeError("this works only while the node's `process` runs, on its own thread")
    return cast(Outputs, now)


def empty(shape: tuple[int, ...], dtype: Any = "u1", output: str | None = None) -> np.ndarray:
    """An array in the host's memory for an output: return it, and nothing is copied. Its contents are undefined.

    ``output`` names the output where the node has several.
    """
    now = _now()
    index = 0 if output is None and len(now.ports) == 1 else now.index.get(output)
    if index is None:
        raise ValueError(f"there is no output `{output}`; the outputs are {', '.join(now.index)}")
    kind = now.ports[index].kind
    allocate = getattr(kind, "allocate", None)
    array: np.ndarray | None = allocate(now.call, index, tuple(shape), np.dtype(dtype)) if allocate else None
    if array is not None:
        now.made[index] = array
    else:
        output = now.ports[index].name
        raise ValueError(f"output `{output}` of type `{kind.packet}` cannot be an array of {np.dtype(dtype)} of shape {tuple(shape)}")
    return array


def empty_like(image: np.ndarray, output: str | None = None) -> np.ndarray:
    """As :func:`empty`, with the shape and type of another array."""
    return empty(image.shape, image.dtype, output)


def tick() -> tuple[int, int, int]:
    """Source, number and capture time (ns of media time) of the tick."""
    return cast(tuple[int, int, int], _now().call.tick())


def clock_ns() -> int:
    """The host's monotonic clock. What a node makes must not depend on it."""
    return int(_now().call.clock_ns())


def age_ms(input: int | None = None) -> float:
    """Age of the light of the tick, or of a frame by its position among all input frames, in ms; NaN where it is unknown."""
    return float(_now().call.age_ns(0xFFFF_FFFF if input is None else input)) / 1e6


def metric(name: str, value: float) -> None:
    """A named number of the node, shown beside its timing."""
    _now().call.metric(name, float(value))


def log(message: str, level: str = "info") -> None:
    """A line for the host's log: ``error``, ``warn``, ``info`` or ``debug``."""
    levels = ("error", "warn", "info", "debug")
    _now().call.log(levels.index(level) + 1, str(message))
