"""Node types: classes with parameters, inputs and outputs that the class itself declares."""

from __future__ import annotations

import inspect
import math
import re
import types
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable

from .packets import KIND_OF_CLASS, Kind

NODES: list[NodeType] = []
"""Node types of the file that is being loaded, in order."""

_FAMILIES = ("source", "filter", "stereo", "stitch", "tools", "arm", "overlay", "sink")
_KINDS = {"compute": 0, "blocking": 1}
_UNIONS = (typing.Union, getattr(types, "UnionType", typing.Union))
"""``Optional[X]`` and ``X | None``, which Python 3.9 does not have."""
OPTIONAL, LIST = 1, 2
"""Flags of a port."""
_REOPEN, _MUST_EXIST, _WRITES = 1, 2, 32


class NodeError(Exception):
    """A node class that cannot be a node type, with what to do about it."""


class End(Exception):
    """Raised by a source: there is nothing more."""


@dataclass(frozen=True)
class Param:
    """A parameter as :func:`param` declares it."""

    default: Any
    range: tuple[float, float] | None
    step: float
    unit: str
    doc: str
    choices: tuple[str, ...]
    reopen: bool
    must_exist: bool
    writes: bool


def param(
    default: Any,
    *,
    range: tuple[float, float] | None = None,
    step: float = 0.0,
    unit: str = "",
    doc: str = "",
    choices: typing.Sequence[str] = (),
    reopen: bool = False,
    must_exist: bool = False,
    writes: bool = False,
) -> Any:
    """Declares a parameter of a node: ``strength: float = ps.param(1.0, range=(0, 10))``.

    The annotation says its type: ``bool``, ``int``, ``float``, ``str``, ``pathlib.Path`` or ``list[float]``; a ``str`` with ``choices`` is one of
    them. Of ``list[float]``, ``range`` is the fewest and the most entries. With ``reopen`` a change makes a new instance instead of setting the
    attribute between two ticks.
    """
    return Param(default, range, step, unit, doc, tuple(choices), reopen, must_exist, writes)


@dataclass(frozen=True)
class Port:
    """An input or output of a node type."""

    name: str
    doc: str
    kind: Kind
    flags: int


@dataclass(frozen=True)
class ParamType:
    """A parameter as the plugin interface has it."""

    name: str
    doc: str
    unit: str
    kind: int
    flags: int
    default_number: float
    min: float
    max: float
    step: float
    default_text: str
    choices: tuple[str, ...]
    default_floats: tuple[float, ...]


@dataclass(frozen=True)
class NodeType:
    """A node type."""

    cls: type
    name: str
    family: str
    doc: str
    kind: int
    is_source: bool
    has_side_effects: bool
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    params: tuple[ParamType, ...]
    returns_dict: bool
    may_be_empty: bool
    """The one output is ``Optional``: ``None`` leaves it empty at a tick."""


def node(
    *, family: str = "filter", name: str | None = None, blocking: bool = False, side_effects: bool = False
) -> Callable[[type], type]:
    """Makes a class a node type. Its name in graphs is ``name``, or the class's in snake_case.

    ``blocking`` gives the node a thread of its own: it may wait. ``side_effects`` says that it writes files or moves something.
    """

    def declare(cls: type) -> type:
        NODES.append(_node_type(cls, family, name or _snake_case(cls.__name__), blocking, side_effects))
        return cls

    return declare


def _snake_case(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def _node_type(cls: type, family: str, name: str, blocking: bool, side_effects: bool) -> NodeType:
    if family not in _FAMILIES:
        raise NodeError(f"{cls.__name__}: family `{family}` does not exist; the families are {', '.join(_FAMILIES)}")
    process = getattr(cls, "process", None)
    if process is None:
        raise NodeError(f"{cls.__name__}: it has no method `process(self, ...)`")
    hints = typing.get_type_hints(process, include_extras=True)
    returns = process.__annotations__.get("return")
    inputs = []
    for parameter in list(inspect.signature(process).parameters.values())[1:]:
        if parameter.name not in hints:
            raise NodeError(f"{cls.__name__}.process: input `{parameter.name}` needs a packet type, as in `{parameter.name}: ps.Gray8`")
        inputs.append(_input(cls, parameter, hints[parameter.name]))
    if isinstance(returns, str):
        # `from __future__ import annotations` makes a dict a text.
        returns = eval(returns, process.__globals__)
    returned = returns if isinstance(returns, dict) else hints.get("return")
    may_be_empty = _is_optional(returned)
    outputs = _outputs(cls, _without_none(returned) if may_be_empty else returned)
    is_source = family == "source"
    if is_source and inputs:
        raise NodeError(f"{cls.__name__}.process: a source has no inputs")
    if not is_source and not inputs:
        raise NodeError(f"{cls.__name__}.process: it has no inputs; a node without inputs is of the family `source`")
    doc = inspect.cleandoc(cls.__doc__ or "")
    return NodeType(
        cls,
        name,
        family,
        doc,
        _KINDS["blocking" if blocking or is_source else "compute"],
        is_source,
        side_effects or family == "sink",
        tuple(inputs),
        outputs,
        _params(cls),
        isinstance(returns, dict),
        may_be_empty,
    )


def _is_optional(annotation: Any) -> bool:
    return typing.get_origin(annotation) in _UNIONS and type(None) in typing.get_args(annotation)


def _without_none(annotation: Any) -> Any:
    return next(member for member in typing.get_args(annotation) if member is not type(None))


def _kind(cls: type, what: str, annotation: Any) -> tuple[Kind, str]:
    """The packet type of an annotation, and its words."""
    metadata = getattr(annotation, "__metadata__", ())
    kind = next((entry for entry in metadata if isinstance(entry, Kind)), None)
    kind = kind or KIND_OF_CLASS.get(getattr(annotation, "__origin__", annotation))
    if kind is None:
        raise NodeError(f"{cls.__name__}.process: {what} is annotated with {annotation!r}, which is no packet type such as `ps.Gray8`")
    return kind, next((entry for entry in metadata if isinstance(entry, str)), "")


def _input(cls: type, parameter: inspect.Parameter, annotation: Any) -> Port:
    flags = 0
    if _is_optional(annotation):
        flags |= OPTIONAL
        annotation = _without_none(annotation)
    elif parameter.default is None:
        flags |= OPTIONAL
    if typing.get_origin(annotation) is list:
        flags |= LIST
        annotation = typing.get_args(annotation)[0]
    kind, doc = _kind(cls, f"input `{parameter.name}`", annotation)
    return Port(parameter.name, doc, kind, flags)


def _outputs(cls: type, annotation: Any) -> tuple[Port, ...]:
    if annotation is None or annotation is type(None):
        return ()
    if not isinstance(annotation, dict):
        kind, doc = _kind(cls, "the result", annotation)
        return (Port(kind.packet, doc, kind, 0),)
    ports = []
    for name, member in annotation.items():
        kind, doc = _kind(cls, f"output `{name}`", member)
        ports.append(Port(name, doc, kind, 0))
    return tuple(ports)


def _params(cls: type) -> tuple[ParamType, ...]:
    hints = typing.get_type_hints(cls, include_extras=False)
    found = {}
    for base in reversed(cls.__mro__):
        found.update({name: value for name, value in vars(base).items() if isinstance(value, Param)})
    return tuple(_param(cls, name, declared, hints.get(name)) for name, declared in found.items())


def _param(cls: type, name: str, declared: Param, annotation: Any) -> ParamType:
    where = f"{cls.__name__}.{name}"
    low, high = declared.range or (-math.inf, math.inf)
    flags = (_REOPEN if declared.reopen else 0) | (_MUST_EXIST if declared.must_exist else 0) | (_WRITES if declared.writes else 0)
    number, text, default = 0.0, "", declared.default
    floats: tuple[float, ...] = ()
    if declared.choices:
        if default not in declared.choices:
            raise NodeError(f"{where}: the default {default!r} is none of {', '.join(declared.choices)}")
        kind, number = 4, float(declared.choices.index(default))
    elif annotation is bool:
        kind, number = 1, float(bool(default))
    elif annotation in (int, float):
        kind, number = (2 if annotation is int else 3), float(default)
        if not low <= number <= high:
            raise NodeError(f"{where}: the default {default!r} is outside of {low:g} to {high:g}")
    elif annotation is str:
        kind, text = 5, str(default)
    elif annotation is Path:
        kind, text = 6, str(default)
    elif typing.get_origin(annotation) is list and typing.get_args(annotation) == (float,):
        kind, floats = 7, tuple(float(value) for value in default)
        low, high = declared.range or (0, math.inf)
    else:
        raise NodeError(f"{where}: a parameter needs a type: bool, int, float, str, pathlib.Path or list[float], as in `{name}: float = ps.param(1.0)`")
    return ParamType(
        name, declared.doc, declared.unit, kind, flags, number, float(low), float(high), float(declared.step), text, declared.choices, floats
    )
