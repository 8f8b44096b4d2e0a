"""A process with limits of time and memory."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from .store import StudyError

_SAMPLE_S = 0.02
"""Between two looks at the memory. New pages come at some GB per second: a run is at most a few 10 MB above its limit."""
_IDLE_S = 1.0
_active: set[int] = set()
"""Process groups that run."""


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    """Exit code; minus the number of the signal that ended it."""
    limit: str
    """The limit that it went beyond, as text; empty for none."""
    seconds: float
    cpu_s: float
    peak_mb: float
    """Most resident memory of one of its processes."""


class Slots:
    """How many processes run at a time. None starts after it was closed."""

    def __init__(self, count: int) -> None:
        self._free, self._is_closed = threading.Semaphore(count), False

    def __enter__(self) -> None:
        self._free.acquire()
        if self._is_closed:
            self._free.release()
            raise StudyError("the study was stopped")

    def __exit__(self, *error: object) -> None:
        self._free.release()

    def close(self) -> None:
        """Lets those that wait fail."""
        self._is_closed = True


def end_all() -> None:
    """Kills all processes that this process runs."""
    for group in list(_active):
        _kill(group)


def _kill(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass


def _children(pid: int) -> list[int]:
    """All descendants of a process."""
    found: list[int] = []
    waiting = [pid]
    while waiting:
        parent = waiting.pop()
        try:
            tasks = os.listdir(f"/proc/{parent}/task")
        except OSError:
            continue
        for task in tasks:
            try:
                text = Path(f"/proc/{parent}/task/{task}/children").read_text()
            except OSError:
                continue
            children = [int(child) for child in text.split()]
            found += children
            waiting += children
    return found


def _memory_kb(pid: int, is_child: bool) -> int:
    """Anonymous memory of a process; of the parent also shared memory, which children map again."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    names = ("RssAnon:",) if is_child else ("RssAnon:", "RssShmem:")
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith(names))


def _beyond(pid: int, began: float, max_s: float, max_memory_mb: Optional[float]) -> str:
    if time.monotonic() - began > max_s:
        return f"it took longer than the limit of {max_s:g} s"
    if max_memory_mb is not None:
        memory_mb = (_memory_kb(pid, False) + sum(_memory_kb(child, True) for child in _children(pid))) / 1024
        if memory_mb > max_memory_mb:
            return f"it took more memory than the limit of {max_memory_mb:g} MB"
    return ""


def run(
    command: Sequence[str],
    log: Path,
    max_s: float,
    max_memory_mb: Optional[float] = None,
    env: Optional[Mapping[str, str]] = None,
) -> Ended:
    """Runs a command to its end, or to a limit. ``log`` gets what it prints; its processes end with this one."""
    began = time.monotonic()
    # `panoscope` ends with the process of this name, whatever ends that.
    env = {**(os.environ if env is None else env), "PANOSCOPE_PARENT": str(os.getpid())}
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, env=env, start_new_session=True)
    pid, limit = process.pid, ""
    _active.add(pid)
    watched = os.pidfd_open(pid)
    try:
        poll = select.poll()
        poll.register(watched, select.POLLIN)
        while True:
            left_s = began + max_s - time.monotonic()
            wait_s = _SAMPLE_S if max_memory_mb is not None else min(max(left_s, 0.0) + 0.001, _IDLE_S)
            if poll.poll(wait_s * 1000):
                break
            limit = _beyond(pid, began, max_s, max_memory_mb)
            if limit:
                break
    finally:
        # Also where the driver is interrupted, and for children that a process left behind.
        _kill(pid)
        _, status, usage = os.wait4(pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        _active.discard(pid)
        os.close(watched)
    seconds = time.monotonic() - began
    return Ended(process.returncode, limit, seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
