"""Panoscope from Python: graphs, recordings, and nodes of one's own.

    import panoscope as ps

    result = ps.Graph("panorama.toml").run(frames=20, watch=["wide.panorama"])
    result["wide.panorama"][0]    # a NumPy array

A file with node classes is a plugin: a graph lists it under ``plugins`` by the name of the file without ``.py``.

    import panoscope as ps

    @ps.node(family="filter")
    class Edges:
        \"""Gradient magnitude.\"""

        strength: float = ps.param(1.0, range=(0, 10), doc="Gain")

        def process(self, image: ps.Gray8) -> ps.Gray8:
            ...

Nodes run in a process of their own. Inputs are read-only views of the host's frames; an array from :func:`empty` is written without a copy.
"""

import sys
from typing import TYPE_CHECKING, Any

try:
    import numpy  # noqa: F401
except ImportError:
    raise ImportError(f"NumPy is missing in {sys.prefix}; install it there: `{sys.executable} -m pip install numpy`") from None

from .call import age_ms, clock_ns, empty, empty_like, log, metric, tick
from .errors import Diagnostic, EditError, GraphError, PanoscopeError, RecordingError, RunError
from .nodes import End, NodeError, node, param
from .packets import (
    AnyImage,
    Bgr8,
    Calibration,
    Cloud,
    Confidence,
    Depth,
    Detections,
    Disparity,
    Gray8,
    Gray16,
    GrayF32,
    Homography,
    Joints,
    Mask,
    Pose,
    Rgba8,
    Roi,
    Scalar,
    Table,
    Text,
    Tip,
)

if TYPE_CHECKING:
    from .building import Arg, Output
    from .columns import Rows, read_table
    from .graph import Graph, Running, check
    from .installation import graphs
    from .recording import Recording, replay
    from .series import Packet, Result, Series
    from .studies.driver import Study, batch
    from .studies.report import report
    from .studies.store import StudyError
    from .studies.worst import worst
    from .sweeps import sweep

_OF_MODULE = {
    **dict.fromkeys(("Graph", "Running", "check"), "graph"),
    **dict.fromkeys(("Recording", "replay"), "recording"),
    **dict.fromkeys(("Packet", "Result", "Series"), "series"),
    **dict.fromkeys(("Arg", "Output"), "building"),
    **dict.fromkeys(("Rows", "read_table"), "columns"),
    **dict.fromkeys(("Study", "batch"), "studies.driver"),
    "StudyError": "studies.store",
    "report": "studies.report",
    "worst": "studies.worst",
    "graphs": "installation",
    "sweep": "sweeps",
}
"""What the process of a node has no use for, and its module: a node starts sooner without it."""

__all__ = [
    "AnyImage", "Arg", "Bgr8", "Calibration", "Cloud", "Confidence", "Depth", "Detections", "Diagnostic", "Disparity", "EditError", "End", "Graph",
    "GraphError", "Gray16", "Gray8", "GrayF32", "Homography", "Joints", "Mask", "NodeError", "Output", "Packet", "PanoscopeError", "Pose",
    "Recording", "RecordingError", "Result", "Rgba8", "Roi", "Rows", "RunError", "Running", "Scalar", "Series", "Study", "StudyError", "Table",
    "Text", "Tip", "age_ms", "batch", "check", "clock_ns", "empty", "empty_like", "graphs", "log", "metric", "node", "param", "read_table",
    "replay", "report", "sweep", "tick", "worst",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _OF_MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_OF_MODULE[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_OF_MODULE})
