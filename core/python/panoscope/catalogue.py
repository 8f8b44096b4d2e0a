"""Node types as methods of graphs that are built.

Type checkers read ``catalogue.pyi`` beside this file, which ``panoscope schema --python`` writes.
"""

from __future__ import annotations

from typing import Any

from .building import Draft, meant, named


class NodeTypes:
    """Has every node type of this machine as a method: ``graph.stereo_bm(left, right, search_px=128)`` adds a node."""

    _draft: Draft | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or self._draft is None:
            what = "" if name.startswith("_") else "; only a graph that is built, `ps.Graph()`, has node types"
            raise AttributeError(f"{type(self).__name__} has no attribute `{name}`{what}")
        return self._draft.maker(meant(name))

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(map(named, self._draft.names()) if self._draft is not None else ())})
