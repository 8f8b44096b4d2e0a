"""Packet types: what the inputs and outputs of a node carry.

Annotate the parameters and the result of ``process`` with them. Planes of pixels are NumPy arrays (rows x columns, or rows x columns x channels),
plain data are NumPy records with the fields of the contract.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, cast

import numpy as np

if TYPE_CHECKING:
    from typing import TypeAlias  # Python 3.9 lacks it.

BYTES, GRAY8, BGR8, RGBA8, GRAY16, F32, CLOUD = range(7)
"""Formats of a frame, as the plugin interface numbers them."""

_PIXELS: dict[int, tuple[np.dtype[Any], int]] = {
    GRAY8: (np.dtype("u1"), 1),
    BGR8: (np.dtype("u1"), 3),
    RGBA8: (np.dtype("u1"), 4),
    GRAY16: (np.dtype("u2"), 1),
    F32: (np.dtype("f4"), 1),
}
_CLOUD_POINT = np.dtype([("xyz_mm", "f4", 3), ("bgr", "u1", 3), ("filled", "u1")])


class Kind:
    """How a packet of one type is read and written."""

    packet: str
    """Name in graph files."""
    formats: int = 0
    """Bit set of the formats that it may have; 0 for plain data."""

    def decode(self, view: Any) -> Any:
        """The value that ``process`` gets."""
        raise NotImplementedError

    def encode(self, value: Any, output: Output) -> None:
        """Makes ``output`` of what ``process`` returned."""
        raise NotImplementedError


@dataclass
class Output:
    """An output of the running call."""

    call: Any
    index: int
    name: str

    def bytes(self, data: bytes) -> None:
        """Makes it plain data."""
        np.asarray(self.call.alloc(self.index, BYTES, 0, 0, 0, len(data)))[:] = np.frombuffer(data, "u1")

    def wrong(self, value: Any, wanted: str) -> TypeError:
        """The error for a value of another type."""
        got = f"{value.dtype} array of shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        return TypeError(f"output `{self.name}` is to be {wanted}, not {got}")


def _pixels(view: Any) -> np.ndarray:
    dtype, channels = _PIXELS[view.format]
    flat = np.asarray(view)
    if channels == 1:
        return np.ndarray((view.height, view.width), dtype, flat, 0, (view.stride_bytes, dtype.itemsize))
    return np.ndarray((view.height, view.width, channels), dtype, flat, 0, (view.stride_bytes, channels, 1))


def _exchanged(value: Any, output: Output, wanted: str) -> np.ndarray:
    """An array over the memory of a tensor of another library, by DLPack: nothing is copied."""
    if not hasattr(value, "__dlpack__"):
        raise output.wrong(value, wanted)
    try:
        return np.from_dlpack(value)
    except (BufferError, RuntimeError, TypeError) as error:
        what = f"{type(value).__module__}.{type(value).__qualname__}"
        raise TypeError(f"output `{output.name}`: NumPy cannot read this {what}: {error}; hand over one in the processor's memory") from error


@dataclass(frozen=True)
class PlaneKind(Kind):
    """A plane of pixels as an array."""

    packet: str
    format_list: tuple[int, ...]

    @property
    def formats(self) -> int:  # type: ignore[override]
        return sum(1 << format for format in self.format_list)

    def decode(self, view: Any) -> np.ndarray:
        return _pixels(view)

    def format_of(self, shape: tuple[int, ...], dtype: np.dtype) -> int | None:
        """The format of an array of this shape and type; none if it cannot be one."""
        if len(shape) not in (2, 3):
            return None
        channels = shape[2] if len(shape) == 3 else 1
        return next((f for f in self.format_list if _PIXELS[f] == (dtype, channels)), None)

    def wanted(self) -> str:
        """The arrays that it takes, in words."""
        shapes = []
        for format in self.format_list:
            dtype, channels = _PIXELS[format]
            shapes.append(f"{dtype} of shape (rows, columns{f', {channels}' if channels > 1 else ''})")
        return f"`{self.packet}`: an array of " + " or ".join(shapes)

    def allocate(self, call: Any, index: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray | None:
        """A writable array in the host's memory."""
        format = self.format_of(shape, dtype)
        if format is None:
            return None
        height, width = shape[:2]
        stride_bytes = width * _PIXELS[format][1] * dtype.itemsize
        array = _pixels(call.alloc(index, format, width, height, stride_bytes, stride_bytes * height))
        return array if len(shape) == 2 or shape[2] > 1 else array[:, :, None]

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, np.ndarray):
            value = _exchanged(value, output, self.wanted())
        format = self.format_of(value.shape, value.dtype)
        if format is None:
            raise output.wrong(value, self.wanted())
        address = value.__array_interface__["data"][0]
        if value.flags.c_contiguous and output.call.is_made(output.index, address, value.nbytes):
            return
        height, width = value.shape[:2]
        if value.strides[-1] == value.itemsize and output.call.forward(output.index, address, format, width, height, value.strides[0]):
            return
        self.allocate(output.call, output.index, value.shape, value.dtype)[...] = value  # type: ignore[index]


@dataclass(frozen=True)
class RecordKind(Kind):
    """Plain data of a fixed layout as a NumPy record."""

    packet: str
    dtype: np.dtype

    def decode(self, view: Any) -> np.record:
        return cast(np.record, np.asarray(view).view(self.dtype).view(np.recarray)[0])

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, np.void) or value.dtype != self.dtype:
            raise output.wrong(value, f"`{self.packet}`: a record, as panoscope.packets.record(\"{self.packet}\") makes it")
        output.bytes(value.tobytes())


class ScalarKind(Kind):
    """One number."""

    packet = "scalar"

    def decode(self, view: Any) -> float:
        return float(np.asarray(view)[:8].view("f8")[0])

    def encode(self, value: Any, output: Output) -> None:
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise output.wrong(value, "`scalar`: a number")
        data = np.zeros(1, _SCALAR)
        data["value"], data["name"] = value, output.name.encode()[:31]
        output.bytes(data.tobytes())


class TextKind(Kind):
    """A text."""

    packet = "text"

    def decode(self, view: Any) -> str:
        return bytes(np.asarray(view)).decode()

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, str):
            raise output.wrong(value, "`text`: a str")
        output.bytes(value.encode())


class CloudKind(Kind):
    """A point per pixel as a structured array (rows x columns) with ``xyz_mm``, ``bgr`` and ``filled``."""

    packet = "cloud"
    formats = 1 << CLOUD

    def decode(self, view: Any) -> np.ndarray:
        return np.ndarray((view.height, view.width), _CLOUD_POINT, np.asarray(view), 0, (view.stride_bytes, 16))

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, np.ndarray) or value.dtype != _CLOUD_POINT or value.ndim != 2:
            raise output.wrong(value, "`cloud`: a structured array (rows, columns) of panoscope.packets.CLOUD_POINT")
        height, width = value.shape
        view = output.call.alloc(output.index, CLOUD, width, height, width * 16, height * width * 16)
        np.ndarray((height, width), _CLOUD_POINT, np.asarray(view))[...] = value


CLOUD_POINT = _CLOUD_POINT
"""One point of a cloud: mm in the camera's frame, its colour, and ``filled``: 0 where it was measured, 1 where it was filled in."""


@dataclass
class Table:
    """Rows of numbers under names with units, such as ``x_mm``."""

    columns: list[str]
    rows: np.ndarray
    """Rows x columns, float64."""

    def __getitem__(self, column: str) -> np.ndarray:
        return self.rows[:, self.columns.index(column)]

    def _repr_html_(self) -> str:
        from .pages import of_table  # The process of a node has no use for it.

        return of_table(self)


class TableKind(Kind):
    """A :class:`Table`."""

    packet = "table"

    def decode(self, view: Any) -> Table:
        data = np.asarray(view)
        rows, columns, names_len, _ = (int(n) for n in data[:16].view("u4"))
        names = bytes(data[16 : 16 + names_len]).rstrip(b"\0").decode()
        values = data[16 + names_len : 16 + names_len + 8 * rows * columns].view("f8").reshape(rows, columns)
        return Table(names.split("\n") if columns else [], values)

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, Table):
            raise output.wrong(value, "`table`: a panoscope.Table")
        rows = np.ascontiguousarray(value.rows, "f8").reshape(-1, len(value.columns))
        names = "\n".join(value.columns).encode()
        names += bytes(-len(names) % 8)
        header = np.array([len(rows), len(value.columns), len(names), 0], "u4")
        output.bytes(header.tobytes() + names + rows.tobytes())


DETECTION = np.dtype(
    [("x_px", "f4"), ("y_px", "f4"), ("width_px", "f4"), ("height_px", "f4"), ("score", "f4"), ("class_index", "u4"), ("track_id", "i8")]
)
"""One box of :class:`Detections`."""
_DETECTIONS = np.dtype([("count", "u4"), ("labels_len", "u4"), ("image_width", "u4"), ("image_height", "u4"), ("masks_len", "u8")])


@dataclass
class Detections:
    """Boxes with their label table."""

    boxes: np.ndarray
    """Structured array of :data:`DETECTION`."""
    labels: list[str] = field(default_factory=list)
    image_size: tuple[int, int] = (0, 0)
    """Width and height in px of the image that was searched."""
    masks: np.ndarray | None = None
    """Of packets ``instances``: boxes x rows x columns, true where the object is."""

    def _repr_html_(self) -> str:
        from .pages import of_detections

        return of_detections(self)


class DetectionsKind(Kind):
    """A :class:`Detections`."""

    packet = "detections"

    def decode(self, view: Any) -> Detections:
        data = np.asarray(view)
        head = data[:24].view(_DETECTIONS)[0]
        end = 24 + 32 * int(head["count"])
        labels = bytes(data[end : end + int(head["labels_len"])]).decode()
        size = (int(head["image_width"]), int(head["image_height"]))
        return Detections(data[24:end].view(DETECTION), labels.split("\n") if labels else [], size)

    def encode(self, value: Any, output: Output) -> None:
        if not isinstance(value, Detections) or value.boxes.dtype != DETECTION:
            raise output.wrong(value, "`detections`: a panoscope.Detections whose boxes are of panoscope.packets.DETECTION")
        labels = "\n".join(value.labels).encode()
        head = np.array([(len(value.boxes), len(labels), *value.image_size, 0)], _DETECTIONS)
        output.bytes(head.tobytes() + value.boxes.tobytes() + labels)


class InstancesKind(Kind):
    """A :class:`Detections` with masks. Read only."""

    packet = "instances"

    def decode(self, view: Any) -> Detections:
        detections = DetectionsKind().decode(view)
        data = np.asarray(view)
        (width, height), count = detections.image_size, len(detections.boxes)
        start = 24 + 32 * count + int(data[4:8].view("u4")[0])
        stride = (width + 7) // 8
        bits = data[start : start + count * height * stride].reshape(count, height, stride)
        detections.masks = np.unpackbits(bits, axis=2, count=width).astype(bool)
        return detections


_CAMERA = np.dtype(
    [("width", "u4"), ("height", "u4"), ("fx", "f8"), ("fy", "f8"), ("cx", "f8"), ("cy", "f8"), ("distortion", "f8", 14)]
)
_SCALAR = np.dtype([("value", "f8"), ("name", "S32"), ("unit", "S16")])
RECORDS = {
    "homography": np.dtype([("left_from_right", "f8", (3, 3)), ("rms_px", "f8"), ("inliers", "u4"), ("state", "u4")]),
    "roi": np.dtype([("x", "i4"), ("y", "i4"), ("width", "i4"), ("height", "i4")]),
    "calibration": np.dtype(
        [
            ("left", _CAMERA),
            ("right", _CAMERA),
            ("right_from_left_rotation", "f8", (3, 3)),
            ("right_from_left_mm", "f8", 3),
            ("rectified_from_left", "f8", (3, 3)),
            ("rectified_from_right", "f8", (3, 3)),
            ("left_projection", "f8", (3, 4)),
            ("right_projection", "f8", (3, 4)),
            ("baseline_mm", "f8"),
            ("rms_px", "f8"),
            ("is_rectified", "u4"),
            ("stated_error", "u4"),
        ]
    ),
    "tip": np.dtype(
        [("u_px", "f8"), ("v_px", "f8"), ("xyz_mm", "f8", 3), ("score", "f8"), ("class_index", "u4"), ("xyz_valid", "u4"), ("track_id", "i8")]
    ),
    "pose": np.dtype([("a_from_b_wxyz", "f8", 4), ("a_from_b_mm", "f8", 3), ("a", "S16"), ("b", "S16")]),
    "joints": np.dtype([("position_rad", "f8", 8), ("velocity_rad_s", "f8", 8), ("count", "u4"), ("reserved", "u4")]),
}
"""Layouts of plain data. Angles are in rad, lengths in mm; matrices are row-major."""


def record(packet: str, **fields: Any) -> np.record:
    """A new record of a packet type with these fields; the others are 0."""
    new = np.zeros(1, RECORDS[packet]).view(np.recarray)
    for name, value in fields.items():
        new[name] = value
    return cast(np.record, new[0])


Gray8: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (GRAY8,))]
"""Image, one byte per pixel. As an input it takes colour too: the host converts."""
Bgr8: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (BGR8,))]
"""Image, blue, green and red bytes."""
Rgba8: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (RGBA8,))]
"""Image, red, green, blue and alpha bytes."""
Gray16: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (GRAY16,))]
"""Image, one 16-bit number per pixel."""
GrayF32: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (F32,))]
"""Image, one float per pixel."""
AnyImage: TypeAlias = Annotated[np.ndarray, PlaneKind("image", (GRAY8, BGR8, RGBA8, GRAY16, F32,))]
"""Image of any format."""
Mask: TypeAlias = Annotated[np.ndarray, PlaneKind("mask", (GRAY8,))]
"""0 or 255."""
Disparity: TypeAlias = Annotated[np.ndarray, PlaneKind("disparity", (F32,))]
"""Pixels of the left rectified view, positive; NaN is unmatched."""
Confidence: TypeAlias = Annotated[np.ndarray, PlaneKind("confidence", (F32,))]
"""0 (unreliable) to 1."""
Depth: TypeAlias = Annotated[np.ndarray, PlaneKind("depth", (F32,))]
"""mm along the left rectified camera's axis; NaN is unknown."""
Cloud: TypeAlias = Annotated[np.ndarray, CloudKind()]
Scalar: TypeAlias = Annotated[float, ScalarKind()]
Text: TypeAlias = Annotated[str, TextKind()]
Homography: TypeAlias = Annotated[np.record, RecordKind("homography", RECORDS["homography"])]
Roi: TypeAlias = Annotated[np.record, RecordKind("roi", RECORDS["roi"])]
Calibration: TypeAlias = Annotated[np.record, RecordKind("calibration", RECORDS["calibration"])]
Tip: TypeAlias = Annotated[np.record, RecordKind("tip", RECORDS["tip"])]
Pose: TypeAlias = Annotated[np.record, RecordKind("pose", RECORDS["pose"])]
Joints: TypeAlias = Annotated[np.record, RecordKind("joints", RECORDS["joints"])]
KIND_OF_CLASS = {Table: TableKind(), Detections: DetectionsKind()}
_KINDS: dict[str, Kind] = {
    **{kind.packet: kind for kind in (ScalarKind(), TextKind(), InstancesKind(), *KIND_OF_CLASS.values())},
    **{packet: RecordKind(packet, dtype) for packet, dtype in RECORDS.items()},
}
"""Packet types of plain data by their names in graph files."""


def decode(view: Any, packet: str) -> Any:
    """The value of any packet: its format says what pixels and points are, ``packet`` is the type of plain data. Bytes of types unknown here."""
    if view.format in _PIXELS:
        return _pixels(view)
    if view.format == CLOUD:
        return CloudKind().decode(view)
    kind = _KINDS.get(packet)
    return np.asarray(view) if kind is None else kind.decode(view)
