"""Loads the file of a plugin and runs one instance of a node. Called by the native part of the package."""

from __future__ import annotations

import sys
import traceback
import types
from pathlib import Path
from typing import Any

from . import call as calls
from . import nodes
from .packets import Output


def load(source: bytes, file: str) -> list[nodes.NodeType]:
    """Runs a plugin's file and returns its node types."""
    path = Path(file)
    folder = str(path.parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    module = types.ModuleType(path.stem)
    module.__file__ = file
    sys.modules[path.stem] = module
    nodes.NODES.clear()
    exec(compile(source, file, "exec", dont_inherit=True), module.__dict__)
    found = list(nodes.NODES)
    if not found:
        raise nodes.NodeError("it declares no node: put `@panoscope.node(...)` in front of a class")
    return found


def explain(error: BaseException) -> str:
    """An exception in one line, with its place, and below it the calls that led there, without those of this package."""
    what = "".join(traceback.format_exception_only(type(error), error)).strip()
    if isinstance(error, nodes.NodeError):
        return str(error)
    package = str(Path(__file__).parent)
    calls = [call for call in traceback.extract_tb(error.__traceback__) if not call.filename.startswith(package)]
    if not calls:
        return what
    place = f"{Path(calls[-1].filename).name}, line {calls[-1].lineno}, in {calls[-1].name}"
    return f"{what} ({place})\n" + "".join(traceback.format_list(calls)).rstrip()


class Runner:
    """An instance of a node."""

    def __init__(self, node_type: nodes.NodeType, values: tuple[Any, ...], node: str, graph_folder: str) -> None:
        self.type = node_type
        self.outputs = calls.Outputs(node_type.outputs)
        self.only_formats = node_type.outputs[0].kind.formats if len(node_type.outputs) == 1 and not node_type.returns_dict else 0
        """Formats of the output, if there is one."""
        cls: Any = node_type.cls
        self.node = cls.__new__(cls)
        self.node.node_name, self.node.graph_folder = node, graph_folder
        self.set_params(values)
        init = cls.__init__
        if init is not object.__init__:
            init(self.node)

    def set_params(self, values: tuple[Any, ...]) -> None:
        """Sets the attributes of the parameters."""
        for declared, value in zip(self.type.params, values):
            setattr(self.node, declared.name, Path(value) if declared.kind == 6 else value)

    def process(self, call: Any, views: tuple[Any, ...]) -> None:
        """One tick: a view, a list of views or none for each input."""
        node_type = self.type
        arguments: list[Any] = []
        for port, view in zip(node_type.inputs, views):
            decode = port.kind.decode
            if port.flags & nodes.LIST:
                arguments.append([decode(one) for one in (view if isinstance(view, list) else [view]) if one is not None])
            else:
                arguments.append(None if view is None else decode(view))
        calls.begin(self.outputs, call)
        try:
            result = self.node.process(*arguments)
            if not self._hand_on(call, result, arguments, views):
                self._give(call, result)
        finally:
            calls.end(self.outputs)

    def _hand_on(self, call: Any, result: Any, arguments: list[Any], views: tuple[Any, ...]) -> bool:
        """Makes the output an input that the node returned as it came, without a look at its bytes. Others are left to the output's type."""
        for argument, view in zip(arguments, views):
            if argument is result and view is not None and self.only_formats >> view.format & 1:
                return bool(call.forward_view(0, view))
        return False

    def _give(self, call: Any, result: Any) -> None:
        outputs = self.type.outputs
        if not outputs:
            return
        if not self.type.returns_dict:
            if result is not None:
                self._encode(call, 0, result)
            elif not self.type.may_be_empty:
                kind = outputs[0].kind.packet
                raise TypeError(
                    f"`process` returned None instead of its output `{outputs[0].name}` of type `{kind}`: return it; "
                    "`-> Optional[...]` declares a node that has no output at some ticks"
                )
            return
        if not isinstance(result, dict):
            names = ", ".join(f'"{port.name}": ...' for port in outputs)
            name = "None" if result is None else type(result).__name__
            raise TypeError(f"`process` returned {name} instead of a dict {{{names}}}; outputs that it leaves out are empty at this tick")
        unknown = set(result) - {port.name for port in outputs}
        if unknown:
            raise TypeError(f"`process` returned `{min(unknown)}`, which is no output of the node")
        for index, port in enumerate(outputs):
            if result.get(port.name) is not None:
                self._encode(call, index, result[port.name])

    def _encode(self, call: Any, index: int, value: Any) -> None:
        # An array of `empty`, as most nodes return it, is the output already.
        if value is not self.outputs.made.get(index):
            port = self.type.outputs[index]
            port.kind.encode(value, Output(call, index, port.name))

    def save_state(self) -> bytes | None:
        """The state that the next instance takes over, if the class saves one."""
        save = getattr(self.node, "save_state", None)
        return None if save is None else bytes(save())

    def load_state(self, state: bytes) -> None:
        """Takes over the state of an earlier instance."""
        load = getattr(self.node, "load_state", None)
        if load is not None:
            load(state)

    def close(self) -> None:
        """Gives back what the node holds."""
        close = getattr(self.node, "close", None)
        if close is not None:
            close()
