"""Pictures as PNG files, for notebooks."""

from __future__ import annotations

import struct
import zlib

import numpy as np


def png(array: np.ndarray) -> bytes | None:
    """An array of pixels as a PNG file: bytes as they are (blue, green, red; or red, green, blue, alpha), other numbers from dark (the 1st of 100
    parts of the known ones) to bright (the 99th). None for what is no picture."""
    shown = _bytes(array)
    if shown is None:
        return None
    height, width = shown.shape[:2]
    channels = 1 if shown.ndim == 2 else shown.shape[2]
    if channels == 3:
        shown = shown[:, :, ::-1]
    # Each row begins with the number of its filter: 0 for none.
    rows = np.zeros((height, 1 + width * channels), "u1")
    rows[:, 1:] = np.ascontiguousarray(shown).reshape(height, width * channels)
    color = {1: 0, 3: 2, 4: 6}[channels]
    head = struct.pack(">IIBBBBB", width, height, 8, color, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def _bytes(array: np.ndarray) -> np.ndarray | None:
    if array.dtype.names is not None or 0 in array.shape:
        return None
    if array.dtype == np.uint8 and (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))):
        return array
    if array.ndim != 2:
        return None
    values = array.astype("f4")
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(array.shape, "u1")
    low, high = np.percentile(values[known], (1, 99))
    scaled = (values - low) * (254.0 / max(high - low, 1e-9)) + 1.0
    return np.where(known, np.clip(scaled, 1, 255), 0).astype("u1")
