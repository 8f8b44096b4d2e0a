"""Nodes for tests: what a node in Python may do with pictures, numbers, tables and state."""

from pathlib import Path
from typing import Annotated, Optional

import numpy as np

import panoscope as ps


@ps.node(family="filter")
class Turn:
    """Turns a picture upside down."""

    def process(self, image: ps.Bgr8) -> ps.Bgr8:
        turned = ps.empty_like(image)
        np.copyto(turned, image[::-1, ::-1])
        return turned


@ps.node(family="filter")
class PassOn:
    """Hands its input on."""

    def process(self, image: ps.AnyImage) -> ps.AnyImage:
        return image


@ps.node(family="filter", name="gain_py")
class Gain:
    """Brightens a picture, and says by how much."""

    gain: float = ps.param(1.5, range=(0.0, 4.0), step=0.1, unit="ratio", doc="Factor")
    invert: bool = ps.param(False, doc="Light becomes dark")
    rounds: int = ps.param(1, range=(1, 9))
    how: str = ps.param("clip", choices=("clip", "wrap"))
    label: str = ps.param("gain", reopen=True)
    curve: list[float] = ps.param([0.0, 1.0], range=(2, 8))
    file: Path = ps.param("", doc="Unused")

    def __init__(self):
        self.name_at_open = self.label

    def process(self, image: Annotated[ps.Gray8, "What is brightened"]) -> {"image": ps.Gray8, "mean": ps.Scalar, "label": ps.Text, "stats": ps.Table}:
        result = image.astype(np.float32) * self.gain**self.rounds
        result = np.clip(result, 0, 255) if self.how == "clip" else np.mod(result, 256)
        result = result.astype(np.uint8)
        if self.invert:
            result = 255 - result
        ps.metric("mean", float(result.mean()))
        source, seq, _ = ps.tick()
        return {
            "image": result,
            "mean": float(result.mean()),
            "label": f"{self.name_at_open} {self.curve} {self.node_name}",
            "stats": ps.Table(["seq", "mean"], np.array([[seq, result.mean()]])),
        }


@ps.node(family="filter")
class Numbers:
    """Reads plain data of several kinds."""

    def process(
        self, calibration: ps.Calibration, detections: Optional[ps.Detections] = None, images: list[ps.AnyImage] = None
    ) -> {"baseline_mm": ps.Scalar, "calibration": ps.Calibration, "boxes": ps.Detections, "count": ps.Scalar}:
        return {
            "baseline_mm": calibration.baseline_mm,
            "calibration": calibration,
            "boxes": detections,
            "count": len(images),
        }


@ps.node(family="source")
class Count:
    """A source with state."""

    last: int = ps.param(5, range=(1, 1_000_000))

    def __init__(self):
        self.count = 0

    def process(self) -> ps.Gray8:
        if self.count == self.last:
            raise ps.End
        picture = ps.empty((4, 6))
        picture[:] = self.count % 256
        self.count += 1
        return picture

    def save_state(self):
        return str(self.count).encode()

    def load_state(self, state):
        self.count = int(state)


@ps.node(family="filter")
class Keep:
    """Hands on the picture of the tick before: keeps a frame beyond its call."""

    def __init__(self):
        self.before = None

    def process(self, image: ps.Gray8) -> ps.Gray8:
        before, self.before = self.before, image
        return image if before is None else before


@ps.node(family="filter")
class Fails:
    """Fails in the way that its parameter names."""

    how: str = ps.param("none", choices=("none", "raise", "shape", "segv", "exit", "loop", "memory"))
    at: int = ps.param(3, range=(0, 1000))

    def process(self, image: ps.Gray8) -> ps.Gray8:
        if ps.tick()[1] != self.at:
            return image
        if self.how == "raise":
            return self.divide(0)
        if self.how == "shape":
            return np.zeros((2, 2, 3), np.float64)
        if self.how == "segv":
            import ctypes

            ctypes.string_at(8)
        if self.how == "exit":
            import os

            os._exit(3)
        while self.how == "loop":
            pass
        if self.how == "memory":
            return np.ones((100, 1024, 1024, 1024), np.uint8)
        return image

    def divide(self, by):
        return 1 // by


@ps.node(family="filter")
class Forgets:
    """Forgets to return its output."""

    def process(self, image: ps.Gray8) -> ps.Gray8:
        image.mean()


@ps.node(family="filter")
class ForgetsBoth:
    """Forgets to return its outputs."""

    def process(self, image: ps.Gray8) -> {"image": ps.Gray8, "mean": ps.Scalar}:
        image.mean()


@ps.node(family="filter")
class EverySecond:
    """Has an output at every second tick."""

    def process(self, image: ps.Gray8) -> Optional[ps.Gray8]:
        return image if ps.tick()[1] % 2 == 0 else None


@ps.node(family="sink")
class Shows:
    """Prints, which must not reach the output of the program."""

    def process(self, image: ps.Gray8) -> None:
        print("a line of a node in Python")
        ps.log(f"mean {image.mean():.1f}")


@ps.node(family="sink")
class Reads:
    """Reads what is no picture."""

    def process(self, label: ps.Text, stats: ps.Table, calibration: ps.Calibration, boxes: ps.Detections, count: ps.Scalar) -> None:
        ps.metric("columns", len(stats.columns) if stats["mean"].shape == (1,) and label.startswith("mine") else -1)
        ps.metric("count", count)
        ps.metric("baseline_mm", calibration.baseline_mm if boxes.image_size == (160, 120) else -1)
