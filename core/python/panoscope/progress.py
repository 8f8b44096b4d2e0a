"""How far a run is: a bar in notebooks and on terminals, nothing elsewhere."""

from __future__ import annotations

import html
import importlib
import sys
import time
from typing import Any

_FIRST_S, _EVERY_S = 0.5, 0.2
"""A run that is over at once shows no bar."""
_WIDTH = 30


def shell() -> Any:
    """IPython's shell of a notebook's kernel; None elsewhere."""
    module = sys.modules.get("IPython")
    found = module.get_ipython() if module is not None else None
    return found if found is not None and getattr(found, "kernel", None) is not None else None


def _display() -> Any:
    return importlib.import_module("IPython.display")


class Bar:
    """``done`` of ``total`` steps; a count without an end where ``total`` is not known."""

    def __init__(self, name: str, total: int | None, wanted: bool | None = None) -> None:
        self._name, self.total = name, total
        self._in_notebook = shell() is not None
        self._is_on = wanted if wanted is not None else self._in_notebook or sys.stderr.isatty()
        self._began = time.monotonic()
        self._next = self._began + (_EVERY_S if wanted else _FIRST_S)
        self._handle: Any = None
        self._is_shown = False

    def is_due(self) -> bool:
        """Whether it is time to show how far the run is."""
        return self._is_on and time.monotonic() >= self._next

    def show(self, done: int) -> None:
        """Draws it."""
        if not self._is_on:
            return
        self._next = time.monotonic() + _EVERY_S
        if self._in_notebook:
            self._draw(done)
        else:
            sys.stderr.write(f"\r\x1b[K{self.text(done)}")
            sys.stderr.flush()
        self._is_shown = True

    def text(self, done: int) -> str:
        """One line: name, bar, count, rate, time that is left."""
        seconds = max(time.monotonic() - self._began, 1e-9)
        rate = done / seconds
        if self.total is None:
            return f"{self._name}  {done}  {rate:.1f}/s"
        full = _WIDTH * min(done, self.total) // max(self.total, 1)
        left = f"  {(self.total - done) / rate:.0f} s left" if 0 < done < self.total else ""
        return f"{self._name} [{'#' * full}{'-' * (_WIDTH - full)}] {done}/{self.total}  {rate:.1f}/s{left}"

    def _draw(self, done: int) -> None:
        display = _display()
        share = "" if self.total is None else f' value="{done}" max="{max(self.total, 1)}"'
        words = html.escape(self.text(done).replace(self._name, "", 1).split("] ")[-1])
        shown = display.HTML(f'<progress style="width: 20em"{share}></progress> {html.escape(self._name)}: {words}')
        if self._handle is None:
            self._handle = display.display(shown, display_id=True)
        else:
            self._handle.update(shown)

    def close(self) -> None:
        """Takes it away."""
        if not self._is_shown:
            return
        if self._handle is not None:
            self._handle.update(_display().HTML(""))
        elif not self._in_notebook:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
        self._is_shown = False
