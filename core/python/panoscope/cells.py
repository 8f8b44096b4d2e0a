"""Node classes of a notebook's cell, or of the script that runs, as the file of a plugin: the class and what it uses."""

from __future__ import annotations

import __future__
import ast
import atexit
import builtins
import hashlib
import inspect
import linecache
import os
import shutil
import symtable
import sys
import tempfile
import textwrap
import types
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import nodes
from .errors import GraphError

_MARK = "# A node class of a notebook or script, written by panoscope."


@dataclass(frozen=True)
class Plugin:
    """The file of a plugin that has the class."""

    node_type: str
    stem: str
    folder: Path
    text: str | None = None
    """Of a file that was written here; ``None`` for a file of the user."""

    def write_into(self, folder: Path) -> None:
        """Writes a file that was written here into another folder too, where a graph is saved."""
        file = folder / f"{self.stem}.py"
        if self.text is None:
            return
        if file.exists() and not file.read_text(encoding="utf-8").startswith(_MARK):
            raise GraphError(f"{file} exists and is not the class of a graph: save the graph in another folder, or name the class differently")
        file.write_text(self.text, encoding="utf-8")


def plugin_of(cls: type) -> Plugin:
    """The plugin of a node class. A class of a module is in the module's file, another one is written into a file."""
    declared = next((found for found in reversed(nodes.NODES) if found.cls is cls), None)
    if declared is None:
        raise GraphError(f"{cls.__name__} is not a node type: put `@ps.node(...)` in front of the class")
    if cls.__module__ != "__main__":
        file = Path(inspect.getfile(cls)).resolve()
        return Plugin(declared.name, file.stem, file.parent)
    text = _Source(vars(sys.modules["__main__"])).of(cls)
    stem = f"{declared.name}_node"
    folder = _folder() / hashlib.sha256(text.encode()).hexdigest()[:16]
    folder.mkdir(exist_ok=True)
    (folder / f"{stem}.py").write_text(text, encoding="utf-8")
    return Plugin(declared.name, stem, folder, text)


_made: list[Path] = []
"""The folder of this process, once there is one."""


def _folder() -> Path:
    if not _made:
        _made.append(Path(tempfile.mkdtemp(prefix="panoscope-nodes-")))
        atexit.register(shutil.rmtree, _made[0], ignore_errors=True)
    return _made[0]


@dataclass
class _Source:
    """Collects definitions, those that others need first."""

    names: dict[str, Any]
    """The globals of the notebook or script."""
    imports: dict[str, None] = field(default_factory=dict)
    folders: dict[str, None] = field(default_factory=dict)
    """Folders of imported modules that only this process searches."""
    parts: list[str] = field(default_factory=list)
    done: set[str] = field(default_factory=set)

    def of(self, cls: type) -> str:
        self._define(cls.__name__, cls, cls.__name__)
        future = ["from __future__ import annotations"] if "annotations" in self.imports else []
        paths = ["import sys", *(f"sys.path.append({folder!r})" for folder in self.folders)] if self.folders else []
        imports = [line for line in self.imports if line != "annotations"]
        return "\n".join([_MARK, *future, *paths, *imports]) + "\n\n\n" + "\n\n\n".join(self.parts) + "\n"

    def _define(self, name: str, thing: Any, user: str) -> None:
        """Adds the source of a class or function."""
        source, has_future = _definition(thing)
        if has_future:
            self.imports["annotations"] = None
        self.done.add(name)
        tree = ast.parse(source)
        chains = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)]
        for needed in sorted(set(_globals_of(symtable.symtable(source, name, "exec")))):
            attributes = [node.attr for node in chains if isinstance(node.value, ast.Name) and node.value.id == needed]
            self._need(needed, attributes, user)
        self.parts.append(source.rstrip())

    def _need(self, name: str, attributes: list[str], user: str) -> None:
        if name in self.done or name not in self.names or hasattr(builtins, name) and getattr(builtins, name) is self.names[name]:
            return
        value = self.names[name]
        if isinstance(value, types.ModuleType):
            self.done.add(name)
            self._import(value.__name__, f"import {value.__name__}" + (f" as {name}" if name != value.__name__ else ""))
            for inner in (f"{value.__name__}.{attribute}" for attribute in attributes):
                if inner in sys.modules:
                    self._import(inner, f"import {inner}")
            return
        if getattr(value, "__module__", None) == "__main__" and isinstance(value, (type, types.FunctionType)):
            return self._define(name, value, user)
        self.done.add(name)
        of_module = _import_of(name, value)
        if of_module is not None:
            return self._import(*of_module)
        if isinstance(value, Path):
            self._import("pathlib", "import pathlib")
            self.parts.append(f"{name} = pathlib.Path({str(value)!r})")
        elif _is_literal(value):
            self.parts.append(f"{name} = {value!r}")
        else:
            raise GraphError(
                f"{user} uses `{name}`, a {type(value).__name__} of the notebook: a node runs in a process of its own and does not see it. "
                "Make it in the class, read it from a file in `__init__`, or pass it as a parameter"
            )

    def _import(self, module: str, line: str) -> None:
        self.imports[line] = None
        file = getattr(sys.modules.get(module.partition(".")[0]), "__file__", None)
        if file is None:
            return
        root = Path(file).resolve().parent
        root = root.parent if Path(file).name == "__init__.py" else root
        inherited = [Path(folder).resolve() for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder]
        prefixes = {Path(prefix).resolve() for prefix in (sys.prefix, sys.base_prefix, sys.exec_prefix)}
        is_searched = root in inherited or any(prefix in root.parents for prefix in prefixes) or "site-packages" in root.parts
        if not is_searched:
            self.folders[str(root)] = None


def _definition(thing: Any) -> tuple[str, bool]:
    """Source of a class or function without its indentation, and whether its annotations are texts."""
    thing = inspect.unwrap(thing) if not isinstance(thing, type) else thing
    if "<locals>" in thing.__qualname__:
        raise GraphError(f"{thing.__qualname__} is defined inside a function: define it at the top of a cell or of a file")
    members = vars(thing).values() if isinstance(thing, type) else [thing]
    codes = [member.__code__ for member in map(inspect.unwrap, filter(callable, members)) if isinstance(member, types.FunctionType)]
    codes = [code for code in codes if linecache.getlines(code.co_filename)]
    # A class without functions of its own is looked for in all cells, the newest first.
    files = list(dict.fromkeys(code.co_filename for code in codes)) or list(reversed(linecache.cache))
    lines_of = {file: linecache.getlines(file) for file in files}
    for file, lines in lines_of.items():
        try:
            tree = ast.parse("".join(lines))
        except SyntaxError:
            continue
        for found in reversed(tree.body):
            if isinstance(found, (ast.ClassDef, ast.FunctionDef)) and found.name == thing.__name__ and _holds(found, file, codes):
                first = min([found.lineno, *(decorator.lineno for decorator in found.decorator_list)])
                future = any(code.co_flags & __future__.annotations.compiler_flag for code in codes)
                return textwrap.dedent("".join(lines[first - 1 : found.end_lineno])), future
    raise GraphError(f"the source of {thing.__name__} is not known: define it in a cell of a notebook or in a file")


def _holds(found: ast.ClassDef | ast.FunctionDef, file: str, codes: list[types.CodeType]) -> bool:
    """Whether a definition has the code; a file may have several of one name."""
    last = found.end_lineno or found.lineno
    first = min([found.lineno, *(decorator.lineno for decorator in found.decorator_list)])
    return not codes or any(code.co_filename == file and first <= code.co_firstlineno <= last for code in codes)


def _globals_of(table: symtable.SymbolTable) -> Iterator[str]:
    """Names that a source takes from outside of itself, by the rules of scopes."""
    for symbol in table.get_symbols():
        is_outer = symbol.is_global() or (table.get_type() == "module" and not symbol.is_assigned() and not symbol.is_namespace())
        if symbol.is_referenced() and is_outer:
            yield symbol.get_name()
    for child in table.get_children():
        yield from _globals_of(child)


def _import_of(name: str, value: Any) -> tuple[str, str] | None:
    """Module and import of a value that a module has under a name."""
    import panoscope

    known = [(panoscope.__name__, exported) for exported in panoscope.__all__ if getattr(panoscope, exported) is value]
    module = getattr(value, "__module__", None) or ""
    known += [(module, found) for key in ("__qualname__", "__name__", "_name") if isinstance(found := getattr(value, key, None), str)]
    for module, found in [*known, (module, name)]:
        if module not in ("", "__main__", "builtins") and getattr(sys.modules.get(module), found, None) is value:
            return module, f"from {module} import {found}" + (f" as {name}" if found != name else "")
    return None


def _is_literal(value: Any) -> bool:
    try:
        return bool(ast.literal_eval(repr(value)) == value)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return False
