"""Texts and numbers: cells of tables, values of parameters, hashes."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Optional

from .. import _native
from ..columns import needed
from .store import StudyError

MAX_STEPS = 10_000
_STREAMS = ("rtsp", "rtsps", "rtmp", "http", "https", "udp", "srt", "tcp")
"""Addresses that nodes read by themselves."""


def number(text: str) -> Any:
    """A number or a switch where the text is one."""
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def digest(value: Any) -> str:
    """128 bits of a value of JSON, as hexadecimal digits."""
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _range(name: str, start: Any, stop: Any, steps: Any) -> list[Any]:
    if not (isinstance(steps, int) and 1 <= steps <= MAX_STEPS):
        raise StudyError(f"{name}: steps are a whole number from 1 to {MAX_STEPS}, not {steps!r}")
    if steps == 1:
        return [start]
    values = [start + (stop - start) * step / (steps - 1) for step in range(steps)]
    is_whole = isinstance(start, int) and isinstance(stop, int) and all(float(value).is_integer() for value in values)
    return [int(value) if is_whole else float(f"{value:.12g}") for value in values]


def of_param(name: str, values: Any) -> list[Any]:
    """Values of a parameter: a list, a ``range``, or (from, to, steps)."""
    if isinstance(values, tuple):
        if len(values) != 3 or not all(isinstance(value, (int, float)) for value in values):
            raise StudyError(f"{name}: a range is (from, to, steps), a list has the values themselves, not {values!r}")
        return _range(name, *values)
    found = list(values) if isinstance(values, (list, range)) else [values]
    if not found:
        raise StudyError(f"{name}: there is no value")
    return found


def params_of_words(words: Iterable[str]) -> dict[str, Any]:
    """``NODE.PARAM=FROM..TO/STEPS`` or ``NODE.PARAM=VALUE,VALUE``."""
    params: dict[str, Any] = {}
    for word in words:
        name, separator, text = word.partition("=")
        match = re.fullmatch(r"(.+)\.\.(.+)/(\d+)", text.strip())
        if not separator or not text.strip():
            raise StudyError(f"--param {word}: write it as NODE.PARAM=FROM..TO/STEPS or NODE.PARAM=VALUE,VALUE")
        if match:
            params[name.strip()] = (number(match[1].strip()), number(match[2].strip()), int(match[3]))
        elif ".." in text:
            raise StudyError(f"--param {word}: give the number of values, as in {name}={text.strip()}/5")
        else:
            params[name.strip()] = [number(value.strip()) for value in text.split(",")]
    return params


def combinations(params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All combinations; the last parameter changes fastest."""
    names = list(params)
    return [dict(zip(names, values)) for values in product(*(of_param(name, params[name]) for name in names))]


def files_of(path: str) -> list[Path]:
    """The files that a path names: itself, those below a folder, or those of a pattern with ``*`` or ``%04d``."""
    place = Path(path)
    if place.is_file():
        return [place]
    if place.is_dir():
        return sorted(file for file in place.rglob("*") if file.is_file())
    pattern = re.sub(r"%0?\d*d", "*", place.name)
    return sorted(file for file in place.parent.glob(pattern) if file.is_file()) if pattern and place.parent.is_dir() else []


def store_of(address: str) -> Optional[tuple[Any, str]]:
    """The file system of fsspec that an address such as ``s3://archive/1.mkv`` names, and the path there; None for a path of this machine."""
    scheme, separator, _ = address.partition("://")
    if not separator or scheme in _STREAMS:
        return None
    system, path = needed("fsspec.core", f"the address {address}").url_to_fs(address)
    return system, str(path)


def stats(paths: Sequence[str]) -> dict[str, list[Any]]:
    """Size and time of change of each file; cheap, where a hash reads them."""
    found: dict[str, list[Any]] = {}
    for path in paths:
        place = store_of(path)
        if place is None:
            files = files_of(path)
            facts: Any = [(os.fspath(file), *((stat := file.stat()).st_size, stat.st_mtime_ns)) for file in files]
        else:
            facts = place[0].find(place[1], detail=True)
        found[path] = [len(facts), digest(facts)]
    return found


def hash_of_inputs(paths: Sequence[str]) -> str:
    """Hash of the bytes of all files that the paths name; where they lie does not count."""
    hashes = [[_native.file_hash(file) for file in files_of(path)] for path in paths]
    return digest(hashes)
