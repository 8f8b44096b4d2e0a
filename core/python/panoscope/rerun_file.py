"""Files of rerun (https://rerun.io), with the package ``rerun-sdk``: ``python -m panoscope.rerun_file RECORDING FILE.rrd``.

Timelines are ``tick`` and ``capture``, the capture time. An entity is named after its port: ``scope/left``. Lengths in space are in m, as rerun has them.

==========================  =======================================================================
packets                     archetypes
==========================  =======================================================================
image                       Image
mask                        SegmentationImage
disparity, confidence       Image of floats
depth                       DepthImage in mm, 1000 to the metre
cloud                       Points3D, m, known points
calibration                 Pinhole and Transform3D of ``left`` and ``right``
detections, roi             Boxes2D
instances                   Boxes2D, and ``masks``: SegmentationImage with the number of the box
tip                         ``pixel``: Points2D, ``position``: Points3D
pose                        Transform3D, and the names of both frames
joints                      ``position_rad`` and ``velocity_rad_s``: Scalars
scalar                      Scalars
table                       Scalars below the name of each column: a value per row
homography                  values of their own
text                        TextLog
==========================  =======================================================================
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from .errors import PanoscopeError, RecordingError
from .packets import BYTES, CLOUD

if TYPE_CHECKING:
    from .recording import Recording
    from .series import Packet

_M = 1e-3
"""Metres in a millimetre."""
_STATES = ("fresh", "held", "lost")
_Entities = Iterator[tuple[tuple[str, ...], list[Any]]]
"""Names below the port, and what is shown there."""


def _rerun() -> Any:
    try:
        import rerun  # type: ignore[import-not-found, unused-ignore]
    except ImportError as error:
        where = f"{sys.executable} -m pip install rerun-sdk"
        raise PanoscopeError(
            f"files of rerun need the package rerun-sdk, which is missing in {sys.prefix} ({error}): `{where}`, or name another interpreter in PANOSCOPE_PYTHON"
        ) from error
    return rerun


class _Entity:
    """Packets as archetypes of rerun: a method per packet type."""

    def __init__(self, rerun: Any) -> None:
        self.rr = rerun

    def image(self, pixels: np.ndarray) -> _Entities:
        model = {3: "BGR", 4: "RGBA"}[pixels.shape[2]] if pixels.ndim == 3 else "L"
        yield (), [self.rr.Image(pixels, color_model=model)]

    disparity = confidence = image

    def mask(self, pixels: np.ndarray) -> _Entities:
        yield (), [self.rr.SegmentationImage(pixels)]

    def depth(self, pixels: np.ndarray) -> _Entities:
        yield (), [self.rr.DepthImage(pixels, meter=1 / _M)]

    def cloud(self, points: np.ndarray) -> _Entities:
        known = points[np.isfinite(points["xyz_mm"]).all(axis=2) & (points["filled"] == 0)]
        yield (), [self.rr.Points3D(known["xyz_mm"] * np.float32(_M), colors=known["bgr"][:, ::-1])]

    def homography(self, value: np.record) -> _Entities:
        state = _STATES[min(int(value.state), len(_STATES) - 1)]
        matrix = value.left_from_right.ravel()
        yield (), [self.rr.AnyValues(left_from_right=matrix, rms_px=float(value.rms_px), inliers=int(value.inliers), state=state)]

    def roi(self, value: np.record) -> _Entities:
        box = [[value.x, value.y, value.width, value.height]]
        yield (), [self.rr.Boxes2D(array=box, array_format=self.rr.Box2DFormat.XYWH)]

    def calibration(self, value: np.record) -> _Entities:
        left_from_right = value.right_from_left_rotation.T
        places = {"left": (np.eye(3), np.zeros(3)), "right": (left_from_right, -left_from_right @ value.right_from_left_mm * _M)}
        for name, (rotation, translation) in places.items():
            camera = value[name]
            matrix = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
            pinhole = self.rr.Pinhole(image_from_camera=matrix, resolution=[int(camera["width"]), int(camera["height"])])
            yield (name,), [pinhole, self.rr.Transform3D(mat3x3=rotation, translation=translation)]

    def detections(self, value: Any) -> _Entities:
        boxes = value.boxes
        array = np.stack([boxes[name] for name in ("x_px", "y_px", "width_px", "height_px")], axis=1)
        yield (), [
            self.rr.Boxes2D(
                array=array,
                array_format=self.rr.Box2DFormat.XYWH,
                labels=[_label(value.labels, box) for box in boxes],
                class_ids=boxes["class_index"].astype("u2"),
            )
        ]

    def instances(self, value: Any) -> _Entities:
        yield from self.detections(value)
        if value.masks is not None and len(value.masks):
            numbers = np.zeros(value.masks.shape[1:], "u2")
            for number, mask in enumerate(value.masks, 1):
                numbers[mask] = number
            yield ("masks",), [self.rr.SegmentationImage(numbers)]

    def tip(self, value: np.record) -> _Entities:
        yield ("pixel",), [self.rr.Points2D([[value.u_px, value.v_px]])]
        known = [value.xyz_mm * _M] if value.xyz_valid == 1 else []
        yield ("position",), [self.rr.Points3D(known)]

    def pose(self, value: np.record) -> _Entities:
        w, x, y, z = value.a_from_b_wxyz
        transform = self.rr.Transform3D(translation=value.a_from_b_mm * _M, quaternion=self.rr.Quaternion(xyzw=[x, y, z, w]))
        names = {name: value[name].decode(errors="replace") for name in ("a", "b")}
        yield (), [transform, self.rr.AnyValues(**names)]

    def joints(self, value: np.record) -> _Entities:
        for name in ("position_rad", "velocity_rad_s"):
            yield (name,), [self.rr.Scalars(value[name][: value["count"]])]

    def scalar(self, value: float) -> _Entities:
        yield (), [self.rr.Scalars(value)]

    def table(self, value: Any) -> _Entities:
        for at, column in enumerate(value.columns):
            yield (column,), [self.rr.Scalars(value.rows[:, at])]

    def text(self, value: str) -> _Entities:
        yield (), [self.rr.TextLog(value)]


def _label(labels: Sequence[str], box: np.record) -> str:
    index, track = int(box["class_index"]), int(box["track_id"])
    name = labels[index] if index < len(labels) else str(index)
    return f"{name} {box['score']:.2f}" + (f" #{track}" if track >= 0 else "")


def _method(recording: Recording, port: str) -> str:
    """Which method of :class:`_Entity` shows the packets of a port."""
    read = recording.native.read(port, 0)
    if read is None:
        raise RecordingError(f"{recording.path} has no packets of `{port}`")
    view = read[0]
    # Pixels and points are shown without their plugin; plain data need the name of their type.
    default = {BYTES: None, CLOUD: "cloud"}.get(view.format, "image")
    try:
        packet_type = recording.native.packet(port)
    except RecordingError:
        if default is None:
            raise
        return default
    if hasattr(_Entity, packet_type):
        return packet_type
    if default is None:
        raise RecordingError(f"packets of type `{packet_type}` are known to their plugin only")
    return default


def write(
    recording: Recording,
    path: str | os.PathLike[str],
    ports: Sequence[str] = (),
    first_tick: int = 0,
    last_tick: int | None = None,
    force: bool = False,
) -> list[dict[str, Any]]:
    """Writes a file of rerun. Returns an entry per port: ``port``, ``packets``, ``form`` and ``at``, or ``left_out`` with the reason."""
    rerun = _rerun()
    path = Path(path)
    if path.exists() and path.samefile(recording.path):
        raise PanoscopeError(f"{path} is the recording itself: choose another file")
    if path.exists() and not force:
        raise PanoscopeError(f"{path} already exists: choose another one, or replace it with --force (`force=True`)")
    series = {port: recording[port] for port in ports or recording}
    part = path.with_name(path.name + ".part")
    stream = rerun.RecordingStream("panoscope")
    reports = []
    try:
        stream.save(part)
        entity = _Entity(rerun)
        for port, packets in series.items():
            chosen = (packet for packet in packets.packets() if first_tick <= packet.tick and (last_tick is None or packet.tick <= last_tick))
            report = _write_port(stream, entity, recording, port, chosen)
            if report:
                reports.append(report)
        stream.flush()
        stream.disconnect()
        os.replace(part, path)
    except BaseException:
        stream.disconnect()
        part.unlink(missing_ok=True)
        raise
    return reports


def _write_port(stream: Any, entity: _Entity, recording: Recording, port: str, packets: Iterator[Packet]) -> dict[str, Any] | None:
    try:
        archetypes: Callable[[Any], _Entities] = getattr(entity, _method(recording, port))
    except RecordingError as error:
        return {"port": port, "packets": len(recording[port]), "left_out": str(error)}
    parts = port.replace(".", "/").split("/")
    forms: list[str] = []
    count = 0
    for packet in packets:
        stream.set_time("tick", sequence=packet.tick)
        stream.set_time("capture", duration=np.timedelta64(packet.capture_ns, "ns"))
        for below, shown in archetypes(packet.value):
            stream.log([*parts, *below], *shown)
            forms.extend(name for one in shown if (name := type(one).__name__) not in forms)
        count += 1
    return {"port": port, "packets": count, "form": ", ".join(forms), "at": "/".join(parts)} if count else None


def main() -> None:
    """What ``panoscope export --rerun`` runs: reports as JSON, or an error in one line."""
    import argparse

    from .recording import Recording

    parser = argparse.ArgumentParser(prog="python -m panoscope.rerun_file", description="Writes a recording as a file of rerun.")
    parser.add_argument("recording")
    parser.add_argument("file")
    parser.add_argument("--port", action="append", default=[], metavar="NODE.PORT", help="only this port; may be given again")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="TICK")
    parser.add_argument("--to", dest="last", type=int, metavar="TICK")
    parser.add_argument("--force", action="store_true", help="replaces a file that exists")
    parser.add_argument("--trust-plugins", action="store_true", help="loads plugins from folders that the recorded graph names")
    given = parser.parse_args()
    try:
        recording = Recording(given.recording, trust_plugins=given.trust_plugins)
        reports = write(recording, given.file, given.port, given.first, given.last, given.force)
    except (PanoscopeError, KeyError, OSError) as error:
        print(f"error: {error.args[0] if isinstance(error, KeyError) else error}", file=sys.stderr)
        sys.exit(2)
    print(json.dumps(reports))


if __name__ == "__main__":
    main()
