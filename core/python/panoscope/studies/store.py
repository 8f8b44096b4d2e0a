"""The folder of a study: which runs are done, and how a run gets there whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import itertools
import json
import os
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Optional

from ..errors import PanoscopeError

MARK, RESULT, INPUTS, COMMAND, LOG = "study.json", "result.json", "inputs.json", "command.json", "log.txt"
TICKS, FILES, FILES_PLACE = "ticks.parquet", "files", "{files}"
"""Of a run; the last one stands in a command for the folder that nodes write into."""
STALE_S = 86_400.0
"""Age at which what an attempt on another machine left behind is removed."""
_numbers = itertools.count()


class StudyError(PanoscopeError):
    """A study cannot be run or read as asked."""


def host() -> str:
    """Name of this machine, without a dot."""
    return socket.gethostname().replace(".", "-") or "host"


def read_json(file: Path) -> Optional[dict[str, Any]]:
    """The object in a file; None where there is none, or half of one."""
    try:
        value = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return None
    return value if isinstance(value, dict) else None


def write_json(file: Path, value: Any) -> None:
    """Writes a file that is not read before its folder is in place."""
    with file.open("w", encoding="utf-8") as stream:
        json.dump(value, stream, sort_keys=True)
        stream.write("\n")


class Store:
    """Layout: ``study.json``; ``runs/KE/KEY`` and ``failed/KE/KEY`` with ``result.json``, ``log.txt`` and the files of the sinks; ``tmp`` with attempts
    that are under way; ``table`` with the data set. A run moves from ``tmp`` to its place by one rename.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, key: str) -> Path:
        """Folder of a run that is done."""
        return self.folder / "runs" / key[:2] / key

    def failed(self, key: str) -> Path:
        """Folder of the newest attempt of a run that failed."""
        return self.folder / "failed" / key[:2] / key

    @property
    def table(self) -> Path:
        """Folder of the data set."""
        return self.folder / "table"

    def scratch(self, key: str) -> Path:
        """A new folder for an attempt; its name has the process that owns it."""
        folder = self.folder / "tmp" / f"{key}.{host()}.{os.getpid()}.{next(_numbers)}"
        folder.mkdir(parents=True)
        return folder

    @contextmanager
    def replacing(self, place: Path) -> Iterator[Path]:
        """A file to write, which then takes its place in one step. Like an attempt it is in ``tmp`` until then."""
        part = self.folder / "tmp" / f"part.{host()}.{os.getpid()}.{next(_numbers)}"
        for folder in (part.parent, place.parent):
            folder.mkdir(parents=True, exist_ok=True)
        yield part
        os.replace(part, place)

    def result(self, key: str) -> Optional[dict[str, Any]]:
        """What a run that is done came to."""
        return read_json(self.run(key) / RESULT)

    def failure(self, key: str) -> Optional[dict[str, Any]]:
        """What the newest attempt of a failed run came to."""
        return read_json(self.failed(key) / RESULT)

    def discard(self, folder: Path) -> None:
        """Removes a folder; it is gone from its place at once."""
        if not folder.exists():
            return
        aside = self.folder / "tmp" / f"old.{host()}.{os.getpid()}.{next(_numbers)}"
        aside.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(folder, aside)
        except FileNotFoundError:
            return
        shutil.rmtree(aside, ignore_errors=True)

    def put(self, scratch: Path, place: Path) -> None:
        """Moves an attempt to its place, in one step; replaces what is there."""
        place.parent.mkdir(parents=True, exist_ok=True)
        while True:
            try:
                os.rename(scratch, place)
                return
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
            self.discard(place)

    def clean(self) -> None:
        """Removes what attempts of processes left behind that are no more."""
        folder = self.folder / "tmp"
        for entry in os.scandir(folder) if folder.is_dir() else ():
            _, owner, pid, *_ = [*entry.name.split("."), "", "", ""]
            if owner == host():
                is_old = not (pid.isdigit() and Path("/proc", pid).exists() and int(pid) != os.getpid())
            else:
                is_old = time.time() - entry.stat(follow_symlinks=False).st_mtime > STALE_S
            if is_old and entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif is_old:
                os.unlink(entry.path)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keeps other drivers out; the lock ends with the process."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / "study.lock").open("a+", encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                file.seek(0)
                owner = file.read().strip() or "another process"
                raise StudyError(f"{self.folder} is being run by {owner}: wait for its end, or stop it") from error
            file.truncate(0)
            file.write(f"process {os.getpid()} on {host()}")
            file.flush()
            yield
