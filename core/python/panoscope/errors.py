"""What the package raises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


class PanoscopeError(Exception):
    """Everything that the package raises of its own."""


@dataclass(frozen=True)
class Diagnostic:
    """A mistake in a graph, or a warning, with its place and what to do."""

    severity: str
    """``error`` or ``warning``."""
    code: str
    """Stable name of the kind of mistake."""
    message: str
    file: str
    line: int
    """From 1; 0 for a file that could not be read."""
    column: int
    label: str
    """Words beside the underlined text; may be empty."""
    help: str
    """What to do; may be empty."""

    @staticmethod
    def list_of(text: str) -> list[Diagnostic]:
        """Those in the JSON text of the native part."""
        import json  # A node starts sooner without it.

        names = Diagnostic.__dataclass_fields__
        return [Diagnostic(**{name: entry[name] for name in names}) for entry in json.loads(text)]


class GraphError(PanoscopeError):
    """A graph has mistakes, or cannot be used as asked. The text shows each with its line and its remedy."""

    def __init__(self, words: str, diagnostics: str = "[]") -> None:
        super().__init__(words)
        self.json = diagnostics
        """The mistakes as ``panoscope check --json`` writes them."""
        self.diagnostics = Diagnostic.list_of(diagnostics)


class EditError(PanoscopeError):
    """A change of a running graph was refused; the graph runs on as it was."""


class RunError(PanoscopeError):
    """A run did not start, or failed."""

    def __init__(self, words: str, faults: list[dict[str, Any]] | None = None) -> None:
        super().__init__(words)
        self.faults = faults or []
        """The faults of the run: ``node``, ``cause``, ``words``, ``seq``, ..."""


class RecordingError(PanoscopeError):
    """A recording cannot be read or played."""
