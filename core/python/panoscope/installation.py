"""The installation that the package belongs to: its program, its plugins and its graphs."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .errors import PanoscopeError

_VARIABLE = "PANOSCOPE_PROGRAM"
"""Names the program for the engine, for plugins and for child processes."""
_HERE = Path(__file__).resolve().parent
_FOLDERS = (_HERE / "installation" / "lib" / "panoscope", _HERE.parent.parent)
"""Of a wheel; of a build or an installed folder, where the package lies in ``python`` beside the program."""

_used: set[Path] = set()
"""The program, once it is known."""


def use(library: str | os.PathLike[str] | None = None) -> Path:
    """Makes graphs of this process use an installation: the folder with its program and ``plugins``. Returns the program.

    Without ``library`` the one that ``PANOSCOPE_PROGRAM`` names, else the one that the package came with.
    """
    named = os.environ.get(_VARIABLE)
    if library is not None:
        program = Path(library).resolve() / "panoscope"
        if _used and program not in _used:
            raise PanoscopeError(f"this process uses another installation already, {min(_used)}; use {program} in another process")
    else:
        program = Path(named) if named else next((f / "panoscope" for f in _FOLDERS if (f / "panoscope").is_file()), _FOLDERS[0] / "panoscope")
    if not program.is_file():
        raise PanoscopeError(f"the program {program} is missing: install Panoscope again, or name its folder in `library`")
    os.environ[_VARIABLE] = str(program)
    # Nodes in Python run in this interpreter unless their file names another one.
    os.environ.setdefault("PANOSCOPE_PYTHON", sys.executable)
    _used.add(program)
    return program


def graphs() -> dict[str, Path]:
    """The graphs that come with the installation, by file name."""
    place = _graph_folder()
    return {file.name: file for file in sorted(place.glob("*.toml"))} if place else {}


def _graph_folder() -> Path | None:
    folder = use().parent
    places = (folder.parent.parent / "share" / "panoscope" / "graphs", folder.parent.parent / "graphs")
    return next((place for place in places if place.is_dir()), None)


def graph_file(path: str | os.PathLike[str]) -> Path:
    """The file of a graph: as named, else the one of that name that comes with the installation."""
    file = Path(path)
    place = None if file.exists() or file.is_absolute() else _graph_folder()
    return place / file if place and (place / file).is_file() else file


def main() -> None:
    """The command ``panoscope``: the program of the installation."""
    program = use()
    os.execv(program, [str(program), *sys.argv[1:]])
