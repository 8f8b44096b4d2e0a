"""Nodes for Panoscope graphs, written in Python.

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

from .call import age_ms, clock_ns, empty, empty_like, log, metric, tick
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

__all__ = [
    "AnyImage", "Bgr8", "Calibration", "Cloud", "Confidence", "Depth", "Detections", "Disparity", "End", "Gray8", "Gray16", "GrayF32",
    "Homography", "Joints", "Mask", "NodeError", "Pose", "Rgba8", "Roi", "Scalar", "Table", "Text", "Tip", "age_ms", "clock_ns", "empty",
    "empty_like", "log", "metric", "node", "param", "tick",
]  # fmt: skip
