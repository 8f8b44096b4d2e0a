"""Where runs are done: threads of this process, any executor of ``concurrent.futures``, a Dask cluster, a Ray cluster.

All of them take plain objects and call :func:`worker.run`, which raises nothing. Each keeps ``window`` runs under way, so that a scheduler holds as many
tasks as its workers soon need and not the whole study.
"""

from __future__ import annotations

import concurrent.futures
import os
import re
import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Optional, Union

from ..columns import needed
from . import process, worker
from .store import StudyError
from .worker import Outcome, Task

Handle = Any
"""A future of the executor's own kind."""
_LOOK_S = 2.0
"""Between two looks at the workers of a cluster."""


class Local:
    """An executor of ``concurrent.futures``; without one, threads that start a process per run.

    One thread more than processes: it hashes the inputs of the next run and writes the row of the last one while the others go on.
    """

    def __init__(self, executor: Optional[concurrent.futures.Executor] = None, jobs: int = 1) -> None:
        self._slots = process.Slots(jobs) if executor is None else None
        self._executor = executor or concurrent.futures.ThreadPoolExecutor(jobs + 1, "panoscope-run")
        workers = getattr(self._executor, "_max_workers", None) or os.cpu_count() or 1
        self.window = 2 * int(workers)

    def submit(self, task: Task) -> Handle:
        """Starts a run."""
        return self._executor.submit(worker.run, task, *([self._slots] if self._slots else []))

    def wait(self, pending: Iterable[Handle], timeout_s: float) -> set[Handle]:
        """Those that are over; waits until there is one, but not longer than ``timeout_s``."""
        return concurrent.futures.wait(pending, timeout_s, concurrent.futures.FIRST_COMPLETED).done

    def outcome(self, handle: Handle) -> Outcome:
        """What became of a run that is over."""
        result: Outcome = handle.result()
        return result

    def avoid(self, name: str) -> bool:
        """Gives no more runs to a worker; False where there is no other one."""
        return False

    def look(self) -> list[str]:
        """What happened to workers since the last call."""
        return []

    def close(self) -> None:
        """Ends the runs that are under way."""
        if self._slots:
            self._executor.shutdown(wait=False, cancel_futures=True)
            self._slots.close()
            process.end_all()
            self._executor.shutdown()


class Dask:
    """A ``distributed.Client``. Dask repeats the runs of a worker that died; one that is silent is removed from the scheduler, which does the same."""

    def __init__(self, client: Any, max_s: float, silent_s: float) -> None:
        self._client, self._silent_s, self._max_s = client, silent_s, max_s
        self._distributed = needed("distributed", "a Dask cluster")
        self._avoided: set[str] = set()
        self._known: set[str] = set()
        self._removed: set[str] = set()
        self._began: dict[tuple[str, str], float] = {}
        self._heard: dict[str, tuple[float, float]] = {}
        """When the scheduler heard last from a worker, by its clock, and since when that is so, by this process's."""
        self._limited: dict[Handle, set[str]] = {}
        """Workers that may do a run, where not all may."""
        self._outcomes: dict[Handle, Outcome] = {}
        self._looked = 0.0
        self._submitted = 0
        self.window = 2
        self._notes = self._examine()

    def _workers(self) -> dict[str, Any]:
        try:
            info = self._client.scheduler_info(n_workers=-1)
        except TypeError:
            info = self._client.scheduler_info()
        return dict(info["workers"])

    def _allowed(self) -> list[str]:
        return sorted(self._known - self._avoided)

    def submit(self, task: Task) -> Handle:
        """Starts a run on a worker that is not avoided."""
        self._submitted += 1
        key = f"panoscope-{task['key']}-{os.getpid()}-{self._submitted}"
        allowed = (self._allowed() if self._avoided else None) or None
        handle = self._client.submit(worker.run, task, pure=False, key=key, workers=allowed)
        if allowed:
            self._limited[handle] = set(allowed)
        return handle

    def wait(self, pending: Iterable[Handle], timeout_s: float) -> set[Handle]:
        """Those that are over, or would wait for ever: for workers that are gone, or for a scheduler that has forgotten them."""
        handles = list(pending)
        stranded = {handle for handle in handles if handle.status == "cancelled" or self._is_stranded(handle)}
        if stranded:
            return stranded
        try:
            done = set(self._distributed.wait(handles, timeout_s, "FIRST_COMPLETED").done)
            # In one message for all; where one of them cannot be had, as from a worker that hangs, each by itself.
            finished = [handle for handle in done if handle.status == "finished"]
            with suppress(Exception):
                outcomes = self._client.sync(self._client._gather, finished, callback_timeout=self._silent_s)
                self._outcomes.update(zip(finished, outcomes))
            return done
        except (TimeoutError, self._distributed.TimeoutError, concurrent.futures.CancelledError):
            return set()

    def _is_stranded(self, handle: Handle) -> bool:
        allowed = self._limited.get(handle)
        return allowed is not None and not allowed & self._known

    def outcome(self, handle: Handle) -> Outcome:
        """What became of a run; a task that Dask gave up is a lost run."""
        is_stranded = self._is_stranded(handle)
        self._limited.pop(handle, None)
        if is_stranded:
            handle.cancel()
            raise StudyError("the workers that it was for are gone")
        result: Outcome = self._outcomes.pop(handle) if handle in self._outcomes else handle.result(self._silent_s)
        return result

    def avoid(self, name: str) -> bool:
        """Gives no more runs to a worker."""
        self._avoided.add(name.split(" ")[0])
        return bool(self._allowed())

    def _remove(self, address: str) -> None:
        # Within a function, so that it is sent whole: the scheduler need not have this package.
        async def remove(dask_scheduler: Any, address: str) -> None:
            await dask_scheduler.remove_worker(address, stimulus_id="panoscope", close=False)

        self._client.run_on_scheduler(remove, address=address)
        self._removed.add(address)

    def _hung(self, workers: dict[str, Any], now: float) -> dict[str, str]:
        """Workers that do not answer, and those whose runs go on for longer than any may."""
        # The clocks of the machines may differ: only whether the scheduler's changes counts.
        news = {address: (float(facts["last_seen"]), now) for address, facts in workers.items()}
        self._heard = {address: old if (old := self._heard.get(address, new))[0] == new[0] else new for address, new in news.items()}
        hung = {address: f"said nothing for {now - since:.0f} s" for address, (_, since) in self._heard.items() if now - since > self._silent_s}
        under_way = {(address, str(key)) for address, keys in self._client.processing().items() for key in keys}
        self._began = {one: self._began.get(one, now) for one in under_way}
        for (address, _), began in self._began.items():
            # A run may wait for the one before it.
            if now - began > 2 * (self._max_s + self._silent_s):
                hung.setdefault(address, "is stuck in a run beyond its limit")
        return hung

    def _examine(self) -> list[str]:
        now = time.monotonic()
        if now - self._looked < _LOOK_S and self._looked:
            return []
        self._looked = now
        workers, notes = self._workers(), []
        for address in sorted(self._known - set(workers) - self._removed):
            notes.append(f"worker {address} is gone; its runs go to others")
        for address, why in sorted(self._hung(workers, now).items()):
            notes.append(f"worker {address} {why}: it was taken out, its runs go to others")
            self._remove(address)
            workers.pop(address, None)
        self._known = set(workers)
        self.window = max(2 * sum(facts["nthreads"] for facts in workers.values()), 2)
        return notes

    def look(self) -> list[str]:
        """Workers that went, and those that were removed. The client tries for some time to reach a scheduler that is gone."""
        if self._client.status not in ("running", "connecting"):
            raise StudyError("the scheduler of Dask is gone: once there is one, the same command goes on where it was")
        try:
            found = self._examine() if self._client.status == "running" else []
        except OSError:
            found = []
        notes, self._notes = self._notes + found, []
        return notes

    def close(self) -> None:
        """The client is the caller's."""


class Ray:
    """A Ray cluster. Ray repeats the runs of a process or a machine that died."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._remote = ray.remote(num_cpus=1, max_retries=3)(worker.run)
        self.window = max(2 * int(ray.cluster_resources().get("CPU", 1)), 2)

    def submit(self, task: Task) -> Handle:
        """Starts a run."""
        return self._remote.remote(task)

    def wait(self, pending: Iterable[Handle], timeout_s: float) -> set[Handle]:
        """Those that are over."""
        done, _ = self._ray.wait(list(pending), num_returns=1, timeout=timeout_s)
        return set(done)

    def outcome(self, handle: Handle) -> Outcome:
        """What became of a run."""
        result: Outcome = self._ray.get(handle)
        return result

    def avoid(self, name: str) -> bool:
        """Ray places the next attempt where it likes."""
        return True

    def look(self) -> list[str]:
        """What happened to workers; Ray says it itself."""
        self.window = max(2 * int(self._ray.cluster_resources().get("CPU", 1)), 2)
        return []

    def close(self) -> None:
        """The cluster is the caller's."""


AnyExecutor = Union[Local, Dask, Ray]


def of(executor: Any, jobs: int, max_s: float, silent_s: float) -> AnyExecutor:
    """The executor for what the caller gave: nothing, a client, ``ray``, an address ``tcp://...`` of Dask, ``ray:ADDRESS``, or an executor."""
    if executor is None:
        return Local(jobs=jobs)
    if isinstance(executor, str):
        if executor.startswith("ray:"):
            ray = needed("ray", "a Ray cluster")
            address = executor[len("ray:") :]
            ray.init(address=address, ignore_reinit_error=True, log_to_driver=False)
            return Ray(ray)
        if re.match(r"(tcp|tls|ws|wss|ucx)://", executor):
            try:
                client = needed("distributed", "a Dask cluster").Client(executor)
            except OSError as error:
                raise StudyError(f"no scheduler of Dask answers at {executor}: {error}") from error
            return Dask(client, max_s, silent_s)
        raise StudyError(f"executor {executor!r}: give tcp://HOST:PORT of a scheduler of Dask, or ray:auto")
    if isinstance(executor, concurrent.futures.Executor):
        return Local(executor)
    if getattr(executor, "__name__", "") == "ray":
        return Ray(executor)
    if hasattr(executor, "scheduler_info"):
        return Dask(executor, max_s, silent_s)
    raise StudyError(f"executor: {type(executor).__name__} is neither an executor of concurrent.futures, nor a distributed.Client, nor the module ray")
