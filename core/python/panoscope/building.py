"""Graphs that are built call by call: the nodes, what connects them, and the text of a graph file that they are."""

from __future__ import annotations

import inspect
import json
import keyword
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypedDict, TypeVar, Union

from . import _native, cells, places
from .errors import GraphError
from .places import Place, Span

P = TypeVar("P")
"""Packet type: ``Literal["image"]``, or any."""


@dataclass(frozen=True)
class Output(Generic[P]):
    """An output of a node, to be an input of others and to be watched."""

    node: str
    port: str
    options: tuple[tuple[str, Any], ...] = ()
    """How it is matched with the other inputs of its reader."""

    def aligned(
        self,
        align: str | None = None,
        *,
        tolerance_ms: float | None = None,
        max_age_ms: float | None = None,
        queue: int | None = None,
        delay: int | None = None,
        trigger: bool | None = None,
        guide: bool | None = None,
        optional: bool | None = None,
    ) -> Output[P]:
        """The output as an input that is matched by ``align`` (``exact``, ``latest``, ``nearest``); ``delay=1`` is the packet of the tick before."""
        given = dict(align=align, tolerance_ms=tolerance_ms, max_age_ms=max_age_ms, queue=queue, delay=delay, trigger=trigger, guide=guide, optional=optional)
        return Output(self.node, self.port, tuple((name, value) for name, value in given.items() if value is not None))

    def __str__(self) -> str:
        return f"{self.node}.{self.port}"


@dataclass(frozen=True)
class Arg:
    """An argument of a graph: stands wherever a value may stand."""

    name: str


# What the stubs of node types are made of.
Input = Union[Output[P], str]
Inputs = Union[Output[P], str, Sequence[Union[Output[P], str]]]
Flag = Union[bool, Arg]
Whole = Union[int, Arg]
Number = Union[float, Arg]
Text = Union[str, Arg]
File = Union[str, "os.PathLike[str]", Arg]
Numbers = Union[Sequence[float], Arg]


class NodeOptions(TypedDict, total=False):
    """What any node may be given, beside its inputs and parameters."""

    on_fault: str
    """``restart``, ``bypass`` or ``stop``."""
    budget_ms: float
    max_rate_hz: float
    cpu: int
    isolate: str
    """Group of nodes that share a process of their own."""
    on: str
    """Machine that it runs on."""


OPTIONS = tuple(NodeOptions.__annotations__)


class Node:
    """A node of a graph that is built."""

    def __init__(self, id: str, outputs: Sequence[str]) -> None:
        self.id = id
        self._outputs = outputs

    def __getitem__(self, port: str) -> Output[Any]:
        return Output(self.id, port)

    def __dir__(self) -> Iterable[str]:
        return [*super().__dir__(), *map(named, self._outputs)]

    def __repr__(self) -> str:
        return f"<node {self.id}: {', '.join(self._outputs) or 'no outputs'}>"


class AnyNode(Node):
    """A node whose outputs no stub knows."""

    def __getattr__(self, port: str) -> Output[Any]:
        if port.startswith("_"):
            raise AttributeError(port)
        # A wrong name is reported by the check of its reader, as in a file.
        return Output(self.id, meant(port))


@dataclass
class Made:
    """A node or part as it was added."""

    id: str
    kind: str
    """``type`` or ``graph``."""
    name: str
    """The type, or the part's file."""
    plugins: list[str]
    inputs: list[tuple[str, Any]]
    params: list[tuple[str, Any]]
    options: list[tuple[str, Any]]
    files: Mapping[str, bool]
    """Parameters that name a file, and whether they may be something else, too."""
    place: Place


@dataclass
class Writer:
    """Writes lines, and remembers which part of a line comes from which call."""

    lines: list[str] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)

    def line(self, text: str = "") -> None:
        self.lines.append(text)

    def from_call(self, place: Place, *parts: tuple[str, tuple[str, ...]]) -> None:
        """A line of parts, each with patterns that find it in the call."""
        text = ""
        for part, patterns in parts:
            self.spans.append(Span(len(self.lines) + 1, len(text), len(text) + len(part), place, patterns))
            text += part
        self.line(text)


def toml(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, Arg):
        return f"{{ arg = {toml(value.name)} }}"
    if isinstance(value, Output):
        if not value.options:
            return toml(str(value))
        options = ", ".join(f"{name} = {toml(option)}" for name, option in value.options)
        return f"{{ from = {toml(str(value))}, {options} }}"
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(name)} = {toml(part)}' for name, part in value.items())} }}"
    raise TypeError(f"a graph has no value of the type {type(value).__name__}")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _is_wired(value: Any) -> bool:
    return isinstance(value, Output) or (isinstance(value, (list, tuple)) and bool(value) and all(isinstance(one, Output) for one in value))


def moved(value: Any, base: Path, folder: Path, must_exist: bool) -> Any:
    """A path that is relative to ``base`` as one that is relative to ``folder``; ``must_exist`` for texts that may be something else than a file."""
    if not isinstance(value, (str, os.PathLike)) or not os.fspath(value) or folder == base or os.path.isabs(value):
        return value
    text = os.fspath(value)
    if must_exist and not ((base / text).exists() or any(True for _ in base.glob(text))):
        return value
    return os.path.relpath(base / text, folder)


class UnknownName(GraphError, AttributeError):
    """A graph has no such node type; also an ``AttributeError``, so that ``hasattr`` works."""


class NodeMaker:
    """A node type of a graph that is built: call it to add a node."""

    def __init__(self, draft: Draft, name: str, described: dict[str, Any]) -> None:
        self._draft, self._name = draft, name
        self.__name__, self.__doc__ = name, doc_of(described)
        self.inputs = sorted((port["name"] for port in described["inputs"]), key=lambda name: self._is_optional(described, name))
        self.params = [param["name"] for param in described["params"]]
        keywords = [*(argument_of(name, self.inputs) for name in self.params), "id", *OPTIONS]
        kinds = [(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in self.inputs] + [(name, inspect.Parameter.KEYWORD_ONLY) for name in keywords]
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind, default=None) for name, kind in kinds])

    @staticmethod
    def _is_optional(described: dict[str, Any], name: str) -> bool:
        return any(port["optional"] for port in described["inputs"] if port["name"] == name)

    def __call__(self, *inputs: Any, id: str | None = None, **values: Any) -> AnyNode:
        if len(inputs) > len(self.inputs):
            raise TypeError(f"`{self._name}` has {len(self.inputs)} inputs ({', '.join(self.inputs)}), {len(inputs)} are given")
        twice = set(self.inputs[: len(inputs)]) & set(values)
        if twice:
            raise TypeError(f"input `{min(twice)}` of `{self._name}` is given twice")
        return self._draft.add(self._name, dict(zip(self.inputs, inputs)), values, id)

    def __repr__(self) -> str:
        return f"<node type {self._name}>"


def named(name: str) -> str:
    """A name as Python takes it: with ``_`` behind a keyword."""
    return f"{name}_" if keyword.iskeyword(name) else name


def meant(name: str) -> str:
    """The other way round."""
    return name[:-1] if name.endswith("_") and keyword.iskeyword(name[:-1]) else name


def argument_of(param: str, inputs: Iterable[str]) -> str:
    """The argument of a call for a parameter: its name, with ``_`` behind it where Python, an input or an option has that name."""
    is_taken = keyword.iskeyword(param) or param in inputs or param == "id" or param in OPTIONS
    return f"{param}_" if is_taken else param


def doc_of(described: dict[str, Any]) -> str:
    """A node type as the text that ``help`` shows."""
    def about(port: dict[str, Any]) -> str:
        return f"    {port['name']} ({port['packet']['name']}): {' '.join(port['doc'].split())}"

    sections = [described["doc"]]
    for title, ports in (("Inputs", described["inputs"]), ("Outputs", described["outputs"])):
        if ports:
            sections.append("\n".join([f"{title}:", *map(about, ports)]))
    if described["params"]:
        sections.append("\n".join(["Parameters:", *map(_about_param, described["params"])]))
    return "\n\n".join(sections)


def _about_param(param: dict[str, Any]) -> str:
    facts = [f"default {param['default']!r}"]
    if param.get("min") is not None and param.get("max") is not None:
        facts.insert(0, f"{param['min']:g} to {param['max']:g}" + (f" {param['unit']}" if param["unit"] else ""))
    if param.get("choices"):
        facts.insert(0, ", ".join(param["choices"]))
    return f"    {param['name']}: {' '.join(param['doc'].split())} ({'; '.join(facts)})"


class Draft:
    """The nodes of a graph that is built."""

    def __init__(self, path: Path, name: str | None, mode: str, plugin_paths: Sequence[str | os.PathLike[str]]) -> None:
        self.path, self.base = path, path.parent
        """The file as mistakes name it, and the folder that relative paths start from."""
        self._name, self._mode = name, mode
        self._folders = [os.fspath(folder) for folder in plugin_paths]
        self._classes: list[cells.Plugin] = []
        """Plugins of node classes that are nodes of the graph."""
        self._catalogue = self._search()
        self._described: dict[tuple[str, str], dict[str, Any]] = {}
        self._args: list[tuple[str, dict[str, Any]]] = []
        self._made: list[Made] = []
        self.version = 0
        """Counts changes."""

    def _search(self) -> _native.Catalogue:
        return _native.Catalogue([*(self.base / folder for folder in self._folders), *(plugin.folder for plugin in self._classes)])

    def take(self, cls: type) -> str:
        """Makes the node type of a class known here; returns its name."""
        plugin = cells.plugin_of(cls)
        if plugin not in self._classes:
            if any(known.stem == plugin.stem for known in self._classes):
                raise GraphError(f"{cls.__name__} has changed since this graph got it: build the graph again")
            self._classes.append(plugin)
            self._catalogue = self._search()
        return f"{plugin.stem}/{plugin.node_type}"

    def write_classes(self, folder: Path) -> None:
        """Writes the plugins of node classes where the graph is saved."""
        for plugin in self._classes:
            plugin.write_into(folder)

    def names(self) -> list[str]:
        """The node types of this machine."""
        return [name for _, name in self._catalogue.names()]

    def maker(self, name: str) -> NodeMaker:
        """The node type of that name."""
        plugins = self._offering(name)
        if not plugins:
            self._unknown(name)
        return NodeMaker(self, name, self._describe(plugins[0], name))

    def _offering(self, name: str) -> list[str]:
        plugin, _, bare = name.rpartition("/")
        return [of for of, offered in self._catalogue.names() if offered == bare and plugin in ("", of)]

    def _describe(self, plugin: str, name: str) -> dict[str, Any]:
        key = (plugin, name.rpartition("/")[2])
        if key not in self._described:
            text = self._catalogue.describe(*key)
            assert text is not None, f"{plugin} says that it has `{name}`"
            self._described[key] = json.loads(text)
        return self._described[key]

    def _unknown(self, name: str) -> None:
        """Raises what a file with that type gets."""
        made = Made("node", "type", name, sorted({plugin for plugin, _ in self._catalogue.names()}), [], [], [], {}, places.caller())
        self._made.append(made)
        try:
            mistakes = self._mistakes(made)
        finally:
            self._made.remove(made)
        mistakes = [entry for entry in mistakes if entry["code"] == "unknown-type"] or mistakes
        raise UnknownName(places.render(mistakes), json.dumps(mistakes))

    def add(self, name: str, inputs: Mapping[str, Any], values: Mapping[str, Any], id: str | None) -> AnyNode:
        """Adds a node of a type; checks it as far as it can be known now."""
        plugins = self._offering(name)
        if not plugins:
            self._unknown(name)
        described = self._describe(plugins[0], name)
        input_names = [port["name"] for port in described["inputs"]]
        param_of = {argument_of(param["name"], input_names): param["name"] for param in described["params"]}
        wired, params, options = dict(inputs), {}, {}
        for argument, value in values.items():
            if argument in OPTIONS:
                options[argument] = value
            elif argument in input_names or (argument not in param_of and _is_wired(value)):
                wired[argument] = value
            else:
                params[param_of.get(argument, argument)] = value
        files = {param["name"]: param["kind"] != "path" for param in described["params"] if param["kind"] == "path" or param.get("pick") == "file"}
        made = self._new("type", name, plugins, (wired, params, options), files, id)
        return AnyNode(made.id, [port["name"] for port in described["outputs"]])

    def part(self, file: str | os.PathLike[str], values: Mapping[str, Any], id: str | None) -> AnyNode:
        """Adds a part: a graph file with inputs and outputs."""
        wired = {name: value for name, value in values.items() if _is_wired(value)}
        options = {name: value for name, value in values.items() if name in ("isolate", "on")}
        params = {name: value for name, value in values.items() if name not in wired and name not in options}
        made = self._new("graph", os.fspath(file), [], (wired, params, options), {}, id or Path(file).stem)
        return AnyNode(made.id, [])

    def _new(
        self,
        kind: str,
        name: str,
        plugins: list[str],
        given: tuple[dict[str, Any], dict[str, Any], dict[str, Any]],
        files: Mapping[str, bool],
        id: str | None,
    ) -> Made:
        inputs, params, options = ([(key, value) for key, value in part.items() if value is not None] for part in given)
        made = Made(id or self._free(name.rpartition("/")[2]), kind, name, plugins, inputs, params, options, files, places.caller())
        self._made.append(made)
        try:
            # An output of a node that is added later may be named already.
            mistakes = [entry for entry in self._mistakes(made) if entry["code"] != "unknown-node"]
            if mistakes:
                raise GraphError(places.render(mistakes), json.dumps(mistakes))
        except BaseException:
            self._made.remove(made)
            raise
        self.version += 1
        return made

    def _free(self, name: str) -> str:
        ids = {made.id for made in self._made}
        return next(id for id in (name if n == 1 else f"{name}_{n}" for n in range(1, len(ids) + 2)) if id not in ids)

    def arg(self, name: str, facts: Mapping[str, Any]) -> Arg:
        """Declares an argument."""
        if any(name == declared for declared, _ in self._args):
            raise GraphError(f"the argument `{name}` is declared twice")
        self._args.append((name, {fact: value for fact, value in facts.items() if value is not None and value != ""}))
        self.version += 1
        return Arg(name)

    def _mistakes(self, made: Made) -> list[dict[str, Any]]:
        """The mistakes of one node, at its call."""
        writer = self._write(self.base)
        found = json.loads(self._catalogue.check(self.path, "\n".join(writer.lines) + "\n"))
        of_node = {id(span) for span in writer.spans if span.place is made.place}
        located = [(entry, places.span_of(entry, str(self.path), writer.spans)) for entry in found if entry["severity"] == "error"]
        return [places.moved_to(entry, span) for entry, span in located if span is not None and id(span) in of_node]

    def text(self, folder: Path | None = None) -> str:
        """The text of the graph; of its file in ``folder``, where :meth:`write_classes` has written."""
        return "\n".join(self._write((folder or self.base).resolve(), is_saved=folder is not None).lines) + "\n"

    def explained(self, error: GraphError) -> GraphError:
        """The error with its mistakes at the calls that they come from."""
        writer = self._write(self.base)
        entries = json.loads(error.json)
        if not entries:
            return error
        entries = [places.moved_to(entry, places.span_of(entry, str(self.path), writer.spans)) for entry in entries]
        return GraphError(places.render(entries), json.dumps(entries))

    def _write(self, folder: Path, is_saved: bool = False) -> Writer:
        writer = Writer()
        plugins = dict.fromkeys(plugin for made in self._made for plugin in made.plugins)
        if self._name:
            writer.line(f"name = {toml(self._name)}")
        writer.line(f"mode = {toml(self._mode)}")
        paths = [moved(path, self.base, folder, False) for path in self._folders]
        paths += ["." if is_saved and plugin.text is not None else str(plugin.folder) for plugin in self._classes]
        if paths:
            writer.line(f"plugin_paths = {toml(list(dict.fromkeys(paths)))}")
        writer.line(f"plugins = {toml(list(plugins))}")
        for name, facts in self._args:
            writer.line()
            writer.line(f"[args.{_key(name)}]")
            for fact, value in facts.items():
                is_path = fact == "default" and facts["type"] in ("source", "file", "path")
                writer.line(f"{fact} = {toml(moved(value, self.base, folder, True) if is_path else value)}")
        for made in self._made:
            self._write_node(writer, made, folder)
        return writer

    def _write_node(self, writer: Writer, made: Made, folder: Path) -> None:
        own = (rf"\b{re.escape(made.name.rpartition('/')[2])}\b",)
        name = moved(made.name, self.base, folder, True) if made.kind == "graph" else made.name
        writer.line()
        writer.from_call(made.place, (f"[nodes.{_key(made.id)}]", own))
        writer.from_call(made.place, (f"{made.kind} = {toml(name)}", own))
        tables = (("inputs", made.inputs), ("params", made.params))
        for table, entries in tables:
            if not entries:
                continue
            parts: list[tuple[str, tuple[str, ...]]] = [(f"{table} = {{ ", own)]
            for index, (key, value) in enumerate(entries):
                if key in made.files:
                    value = moved(value, self.base, folder, made.files[key])
                ports = [one.port for one in (value if isinstance(value, (list, tuple)) else [value]) if isinstance(one, Output)]
                patterns = (*(rf"(?<=\.){re.escape(port)}\b" for port in ports), rf"\b{re.escape(key)}_?(?=\s*=)", *own)
                comma = ", " if index else ""
                parts.append((f"{comma}{_key(key)} = {toml(value)}", patterns))
            writer.from_call(made.place, *parts, (" }", own))
        for option, value in made.options:
            writer.from_call(made.place, (f"{option} = {toml(value)}", (rf"\b{option}(?=\s*=)", *own)))
