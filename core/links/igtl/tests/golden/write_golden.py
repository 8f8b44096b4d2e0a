"""Writes messages with pyigtl, as lines of a name and hexadecimal bytes. core/links/igtl/tests/golden.rs compares its output with pyigtl.txt."""

import numpy as np
import pyigtl


def write(name, message, version, metadata=None):
    message.header_version = version
    message.message_id = 7 if version > 1 else 0
    message.metadata = metadata or {}
    print(name, message.pack().hex())


def common():
    return {"timestamp": 1700000000.25, "device_name": "Device"}


matrix = np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], dtype=np.float32)
spacing = np.diag([0.5, 0.5, 0.5, 1.0])
pixels = np.arange(18, dtype=np.uint8).reshape(1, 2, 3, 3) * 10
gray = np.arange(12, dtype="<u2").reshape(1, 3, 4)
triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)

for version, metadata in ((1, None), (2, None), (3, {"TransformStatus": "OK", "frame": "12"})):
    write(f"transform_v{version}", pyigtl.TransformMessage(matrix, **common()), version, metadata)
    write(f"image_v{version}", pyigtl.ImageMessage(pixels, spacing, "ras", **common()), version, metadata)
    write(f"image16_v{version}", pyigtl.ImageMessage(gray, spacing, **common()), version, metadata)
    write(f"string_v{version}", pyigtl.StringMessage("a text", **common()), version, metadata)
    points = pyigtl.PointMessage(
        positions=[[1.5, -2.5, 3.5], [7, 8, 9]],
        names=["Target", "Entry"],
        rgba_colors=[[255, 128, 0, 255], [0, 0, 255, 64]],
        diameters=[4, 1],
        groups="Landmark",
        owners="Picture",
        **common(),
    )
    write(f"point_v{version}", points, version, metadata)
    faces = np.array([3, 0, 1, 2], dtype=np.uint32)
    write(f"polydata_v{version}", pyigtl.PolyDataMessage(points=triangle, polygons=faces, **common()), version, metadata)
