"""Runs a node of one's own on arrays, without a host: for tests.

    from panoscope.testing import Node

    def test_edges():
        edges = Node(Edges, strength=2.0)
        assert edges(image=np.zeros((4, 4), np.uint8)).max() == 0

Inputs and results are checked as a host does. What only a host can do is left out: conversion of colours, limits of time, memory of its own.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from . import nodes
from .packets import Kind, Output, decode
from .runner import Runner


class _View:
    """A frame in memory of this process."""

    def __init__(self, data: np.ndarray, format: int, width: int, height: int, stride_bytes: int, is_writable: bool) -> None:
        self.data, self.len = data, data.size
        self.format, self.width, self.height, self.stride_bytes = format, width, height, stride_bytes
        self.is_writable = is_writable

    @property
    def __array_interface__(self) -> dict[str, Any]:
        address = self.data.__array_interface__["data"][0]
        return {"shape": (self.len,), "typestr": "|u1", "data": (address, not self.is_writable), "version": 3}


class _Call:
    """What stands for the host in a call."""

    def __init__(self, tick: tuple[int, int, int]) -> None:
        self._tick = tick
        self.made: dict[int, _View] = {}
        self.inputs: list[_View] = []
        self.metrics: dict[str, float] = {}
        self.lines: list[str] = []

    def alloc(self, output: int, format: int, width: int, height: int, stride_bytes: int, len: int) -> _View:
        self.made[output] = _View(np.empty(len, "u1"), format, width, height, stride_bytes, True)
        return self.made[output]

    def is_made(self, output: int, address: int, len: int) -> bool:
        view = self.made.get(output)
        return view is not None and view.len == len and view.__array_interface__["data"][0] == address

    def forward(self, output: int, address: int, format: int, width: int, height: int, stride_bytes: int) -> bool:
        for view in self.inputs:
            described = (view.format, view.width, view.height, view.stride_bytes)
            if view.__array_interface__["data"][0] == address and described == (format, width, height, stride_bytes):
                self.made[output] = view
                return True
        return False

    def forward_view(self, output: int, view: _View) -> bool:
        self.made[output] = view
        return True

    def tick(self) -> tuple[int, int, int]:
        return self._tick

    def set_capture_ns(self, capture_ns: int) -> None:
        self._tick = (*self._tick[:2], capture_ns)

    def clock_ns(self) -> int:
        return time.monotonic_ns()

    def age_ns(self, input: int) -> float:
        return 0.0

    def metric(self, name: str, value: float) -> None:
        self.metrics[name] = value

    def log(self, level: int, message: str) -> None:
        self.lines.append(message)


class Node:
    """An instance of a node class. Calling it runs one tick; inputs are given by name, and the result is the output, or a dict of outputs."""

    def __init__(self, cls: type, **params: Any) -> None:
        declared = next((known for known in reversed(nodes.NODES) if known.cls is cls), None)
        if declared is None:
            raise nodes.NodeError(f"{cls.__name__} is no node: put `@panoscope.node(...)` in front of it")
        self._type = declared
        unknown = set(params) - {param.name for param in declared.params}
        if unknown:
            raise TypeError(f"{cls.__name__} has no parameter `{min(unknown)}`")
        self._values = {param.name: _default(param) for param in declared.params}
        self._runner = Runner(declared, self._checked(params), "test", ".")
        self._ticks = 0
        self.metrics: dict[str, float] = {}
        """What the node said with ``ps.metric``, the newest of each name."""
        self.log: list[str] = []
        """What it said with ``ps.log``."""

    @property
    def instance(self) -> Any:
        """The object of the class."""
        return self._runner.node

    def _checked(self, params: dict[str, Any]) -> tuple[Any, ...]:
        for param in self._type.params:
            value = params.get(param.name)
            if value is None:
                continue
            if param.choices and value not in param.choices:
                raise ValueError(f"`{param.name}` is one of {', '.join(param.choices)}, not {value!r}")
            size = len(value) if param.kind == 7 else value
            if param.kind in (2, 3, 7) and not param.min <= size <= param.max:
                raise ValueError(f"`{param.name}` is {param.min:g} to {param.max:g}, not {value!r}")
            self._values[param.name] = value
        return tuple(self._values.values())

    def set(self, **params: Any) -> None:
        """Sets parameters between two ticks."""
        self._runner.set_params(self._checked(params))

    def __call__(self, **inputs: Any) -> Any:
        names = [port.name for port in self._type.inputs]
        unknown = set(inputs) - set(names)
        if unknown:
            raise TypeError(f"the node has no input `{min(unknown)}`; it has {', '.join(names) or 'none'}")
        call = _Call((0, self._ticks, self._ticks * 33_333_333))
        views = tuple(self._input(call, port, inputs.get(port.name)) for port in self._type.inputs)
        self._ticks += 1
        try:
            self._runner.process(call, views)
        finally:
            self.metrics.update(call.metrics)
            self.log += call.lines
        outputs = self._type.outputs
        values = {port.name: _value(port.kind, call.made.get(index)) for index, port in enumerate(outputs)}
        return values if self._type.returns_dict else next(iter(values.values()), None)

    @staticmethod
    def _input(call: _Call, port: nodes.Port, value: Any) -> Any:
        if value is None:
            if port.flags & nodes.OPTIONAL:
                return None
            raise TypeError(f"input `{port.name}` is missing")
        values = value if port.flags & nodes.LIST else [value]
        views = []
        for one in values:
            source = _Call((0, 0, 0))
            # As an output of another node: the same checks, and the same bytes.
            port.kind.encode(one, Output(source, 0, port.name))
            view = source.made[0]
            view.is_writable = False
            views.append(view)
        call.inputs += views
        return views if port.flags & nodes.LIST else views[0]

    def save_state(self) -> bytes | None:
        """What the next instance takes over."""
        return self._runner.save_state()

    def load_state(self, state: bytes) -> None:
        """Takes over the state of another instance."""
        self._runner.load_state(state)

    def close(self) -> None:
        """Gives back what the node holds."""
        self._runner.close()


def _default(param: nodes.ParamType) -> Any:
    if param.choices:
        return param.choices[int(param.default_number)]
    numbers = {1: bool, 2: int, 3: float}
    if param.kind in numbers:
        return numbers[param.kind](param.default_number)
    return list(param.default_floats) if param.kind == 7 else param.default_text


def _value(kind: Kind, view: _View | None) -> Any:
    return None if view is None else decode(view, kind.packet)
