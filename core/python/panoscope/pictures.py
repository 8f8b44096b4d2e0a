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
    if array.dtype.names is not None or array.ndim not in (2, 3) or 0 in array.shape:
        return None
    if array.dtype == np.uint8 and (array.ndim == 2 or array.shape[2] in (3, 4)):
        return array
    if array.ndim != 2:
        return None
    share, known = _shares(array, usual_range(array))
    return np.where(known, 1 + 254 * share, 0).astype("u1")


def usual_range(array: np.ndarray) -> tuple[float, float]:
    """The 1st and the 99th of 100 parts of the known numbers; 0 and 1 where none is known."""
    known = array[np.isfinite(array)]
    if not known.size:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(known.astype("f4"), (1, 99)))
    return low, max(high, low + 1e-6 * max(abs(low), 1.0))


def _shares(array: np.ndarray, limits: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Each number as a share of the range, 0 to 1, and whether it is known."""
    low, high = limits
    values = array.astype("f4")
    known = np.isfinite(values)
    return np.clip((np.where(known, values, low) - low) / (high - low), 0, 1), known


_COLOURS = np.array([(48, 18, 59), (70, 107, 227), (40, 187, 236), (49, 242, 153), (162, 252, 60), (237, 208, 58), (251, 128, 34), (209, 49, 5), (122, 4, 3)], "f4")
"""Red, green, blue from low to high: of the colour map Turbo."""
_UNKNOWN = 48
"""Gray of unknown pixels."""


def coloured(array: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """A map of numbers in colours, blue, green and red; unknown ones are dark gray."""
    share, known = _shares(array, limits)
    steps = np.arange(len(_COLOURS)) / (len(_COLOURS) - 1)
    planes = [np.where(known, np.interp(share, steps, _COLOURS[:, channel]), _UNKNOWN) for channel in (2, 1, 0)]
    return np.stack(planes, 2).astype("u1")


def gradient() -> str:
    """The colours from low to high as a list of CSS."""
    return ", ".join(f"rgb({red:.0f},{green:.0f},{blue:.0f})" for red, green, blue in _COLOURS)
