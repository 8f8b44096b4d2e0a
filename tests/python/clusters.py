"""Studies on a Dask cluster of processes, each on a network of its own where permitted: workers that are killed, hang, lack a plugin, and runs that take too much memory. Started by
tests/tests/batches.rs. `PANOSCOPE_BATCH_RUNS` sets the number of runs.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path
from typing import Any, Optional, cast

import dask
import distributed
import pyarrow.parquet as parquet
from PIL import Image

import panoscope as ps
from panoscope.studies import executors, worker
from panoscope.studies.store import read_json

RUNS = int(os.environ.get("PANOSCOPE_BATCH_RUNS", "8"))
COMMAND = Path(os.environ["PANOSCOPE_BIN"])
MAX_S = 120.0
SILENT_S = 3.0
MAX_MEMORY_MB = 150
GRAPH = """
mode = "batch"
plugins = ["capture", "flow"]
[args.clip]
type = "source"
[nodes.views]
type = "capture"
params = { left = { arg = "clip" } }
[nodes.light]
type = "level"
inputs = { image = "views.left" }
[nodes.end]
type = "drain"
inputs = { image = "views.left" }
"""


class FakeRay:
    """What of the module `ray` is used, with processes in place of a cluster: it shows that the calls fit each other, not that Ray does its part."""

    __name__ = "ray"

    def __init__(self) -> None:
        from concurrent.futures import ThreadPoolExecutor

        self.pool = ThreadPoolExecutor(2)

    def remote(self, **options: Any) -> Any:
        pool = self.pool

        class Function:
            def __init__(self, function: Any) -> None:
                self.function = function

            def remote(self, task: Any) -> Any:
                return pool.submit(self.function, task)

        return Function

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 2.0}

    def wait(self, handles: list[Any], num_returns: int, timeout: float) -> tuple[list[Any], list[Any]]:
        from concurrent.futures import FIRST_COMPLETED, wait

        done, pending = wait(handles, timeout, FIRST_COMPLETED)
        return list(done)[:num_returns], [*list(done)[num_returns:], *pending]

    def get(self, handle: Any) -> Any:
        return handle.result()


def ip(*words: str) -> bool:
    return subprocess.run(["ip", *words], capture_output=True).returncode == 0


class Lan:
    """A scheduler's machine and others on one network: network namespaces around a bridge, which this process reaches, too."""

    def __init__(self, machines: int) -> None:
        process = os.getpid()
        # Rust tests remove namespaces of this name whose process has ended, and choose their networks likewise.
        self.names = [f"panoscope-{process}-{number}" for number in range(machines + 1)]
        self.network = f"10.{128 + (process >> 6 & 0x7F)}.{(process & 0x3F) << 2}"
        self.device = f"ps{process % 100_000}lan"

    def address(self, number: int) -> str:
        return f"{self.network}.{number + 1}"

    def words(self, number: int) -> list[str]:
        """In front of a command of a machine; 0 is that of the scheduler."""
        return ["ip", "netns", "exec", self.names[number]]

    def start(self) -> bool:
        """Whether this user may make it."""
        hub, *others = self.names
        made = ip("netns", "add", hub) and ip("-n", hub, "link", "add", "lan", "type", "bridge")
        made = made and ip("-n", hub, "addr", "add", f"{self.address(0)}/24", "dev", "lan")
        made = made and ip("link", "add", self.device, "type", "veth", "peer", "name", "port0", "netns", hub)
        made = made and ip("addr", "add", f"{self.network}.254/24", "dev", self.device) and ip("link", "set", self.device, "up")
        for number, name in enumerate(others, 1):
            made = made and ip("netns", "add", name) and ip("-n", name, "link", "set", "lo", "up")
            made = made and ip("-n", name, "link", "add", "eth0", "type", "veth", "peer", "name", f"port{number}", "netns", hub)
            made = made and ip("-n", name, "addr", "add", f"{self.address(number)}/24", "dev", "eth0") and ip("-n", name, "link", "set", "eth0", "up")
        ports = [f"port{number}" for number in range(len(self.names))]
        made = made and all(ip("-n", hub, "link", "set", port, "master", "lan") for port in ports)
        return made and all(ip("-n", hub, "link", "set", device, "up") for device in ("lo", "lan", *ports))

    def cut(self, number: int) -> None:
        """Pulls the cable of a machine."""
        ip("-n", self.names[number], "link", "set", "eth0", "down")

    def end(self) -> None:
        ip("link", "del", self.device)
        for name in self.names:
            ip("netns", "del", name)


class Clusters(unittest.TestCase):
    def setUp(self) -> None:
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)
        self.graph = self.folder / "graph.toml"
        self.graph.write_text(GRAPH)
        self.processes: list[subprocess.Popen[bytes]] = []
        self.rows = [{"clip": self.picture(f"{number}.png", (32, 24), number % 200)} for number in range(RUNS)]

    def picture(self, name: str, size: tuple[int, int], light: int) -> str:
        file = self.folder / name
        Image.new("L", size, light).save(file)
        return str(file)

    def worker(self, address: str, **env: str) -> subprocess.Popen[bytes]:
        words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads=1", "--no-nanny", "--no-dashboard", "--memory-limit=0"]
        words += ["--local-directory", str(self.folder)]
        log = (self.folder / f"worker{len(self.workers)}.log").open("wb")
        self.addCleanup(log.close)
        process = subprocess.Popen(words, env={**os.environ, **env}, stdout=log, stderr=subprocess.STDOUT)
        self.workers.append(process)

        def end() -> None:
            process.kill()
            process.wait()

        self.addCleanup(end)
        return process

    def other_installation(self) -> Path:
        """The program with all plugins but one."""
        place = self.folder / "other"
        (place / "plugins").mkdir(parents=True)
        (place / "panoscope").symlink_to(COMMAND)
        for file in (COMMAND.parent / "plugins").iterdir():
            if "flow" not in file.name:
                (place / "plugins" / file.name).symlink_to(file)
        return place / "panoscope"

    def start(self, words: list[str], log: str) -> subprocess.Popen[bytes]:
        stream = (self.folder / log).open("wb")
        self.addCleanup(stream.close)
        process = subprocess.Popen(words, stdout=stream, stderr=subprocess.STDOUT)
        self.processes.append(process)

        def end() -> None:
            process.kill()
            process.wait()

        self.addCleanup(end)
        return process

    def lan(self) -> Optional[Lan]:
        """Four machines and that of the scheduler, where this user may make networks."""
        lan = Lan(4)
        self.addCleanup(lan.end)
        return lan if lan.start() else None

    def scheduler(self, lan: Optional[Lan]) -> str:
        """Starts a scheduler; returns its address."""
        file = self.folder / "scheduler.json"
        words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard", "--scheduler-file", str(file)]
        words += ["--host", lan.address(0) if lan else "127.0.0.1", "--port", "0"]
        self.start([*(lan.words(0) if lan else []), *words], "scheduler.log")
        until = time.monotonic() + MAX_S
        while time.monotonic() < until:
            # It may be half written.
            address = (read_json(file) or {}).get("address")
            if address:
                return str(address)
            time.sleep(0.05)
        raise AssertionError((self.folder / "scheduler.log").read_text())

    def worker(self, address: str, number: int, lan: Optional[Lan], **env: str) -> subprocess.Popen[bytes]:
        words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads=1", "--no-nanny", "--no-dashboard", "--memory-limit=0"]
        words += ["--local-directory", str(self.folder), "--name", f"machine{number}"]
        variables = ["env", *(f"{name}={value}" for name, value in env.items())]
        return self.start([*(lan.words(number) if lan else []), *variables, *words], f"worker{number}.log")

    def other_installation(self) -> Path:
        """The program with all plugins but one."""
        place = self.folder / "other"
        (place / "plugins").mkdir(parents=True)
        (place / "panoscope").symlink_to(COMMAND)
        for file in (COMMAND.parent / "plugins").iterdir():
            if "flow" not in file.name:
                (place / "plugins" / file.name).symlink_to(file)
        return place / "panoscope"

    @unittest.skipUnless("PANOSCOPE_BATCH_RUNS" in os.environ, "four workers take some seconds to start: `cargo xtask test batches`")
    def test_a_study_survives_its_workers_and_names_each(self) -> None:
        rows = [*self.rows, {"clip": self.picture("large.png", (7000, 5000), 9)}]
        said: list[str] = []
        lan = self.lan()
        print("workers are", "on machines of their own, for the network" if lan else "on this machine: no permission for network namespaces")
        address = self.scheduler(lan)
        good, killed, hung = (self.worker(address, number, lan) for number in (1, 2, 3))
        self.worker(address, 4, lan, PANOSCOPE_PROGRAM=str(self.other_installation()))
        with distributed.Client(address) as client:
            client.wait_for_workers(4, MAX_S)

            def say(text: str) -> None:
                if not said:
                    # Their first runs are about to be handed out.
                    if lan:
                        lan.cut(3)
                    else:
                        os.kill(hung.pid, signal.SIGSTOP)
                    os.kill(killed.pid, signal.SIGKILL)
                said.append(text)

            options: dict[str, Any] = {"threads": 1, "max_memory_mb": MAX_MEMORY_MB, "max_s": 60, "silent_s": SILENT_S}
            study = ps.batch(self.graph, rows, self.folder / "study", executor=client, say=say, **options)
            self.assertIsNone(good.poll())
        self.assertEqual((study.counts["done"], study.counts["failed"], study.counts["open"]), (RUNS, 1, 0), (study.failures, said))
        (error,) = study.failures.values()
        self.assertIn(f"more memory than the limit of {MAX_MEMORY_MB} MB", error)
        notes = "\n".join(study.notes)
        self.assertIn("is gone", notes)
        self.assertRegex(notes, "said nothing for .* taken out")
        self.assertRegex(notes, "gets no more runs: plugin `flow`: .* does not exist")
        self.compare(study)

    @unittest.skipUnless("PANOSCOPE_BATCH_RUNS" in os.environ, "a scheduler takes some seconds to start: `cargo xtask test batches`")
    def test_a_scheduler_that_ends_ends_the_study_which_goes_on_later(self) -> None:
        address = self.scheduler(None)
        self.worker(address, 1, None)

        def kill() -> None:
            """Once a run is done."""
            while not list((self.folder / "study").glob("runs/*/*")):
                time.sleep(0.01)
            self.processes[0].kill()

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        with dask.config.set({"distributed.comm.timeouts.connect": "2s"}):
            with self.assertRaisesRegex(ps.StudyError, "the scheduler of Dask is gone"):
                ps.batch(self.graph, self.rows, self.folder / "study", executor=address, threads=1)
            with self.assertRaisesRegex(ps.StudyError, f"no scheduler of Dask answers at {address}"):
                ps.batch(self.graph, self.rows, self.folder / "study", executor=address, threads=1)
        study = ps.batch(self.graph, self.rows, self.folder / "study", threads=1)
        self.assertEqual((study.counts["done"] + study.counts["kept"], study.counts["open"]), (RUNS, 0), study.failures)
        self.assertGreater(study.counts["kept"], 0)

    def test_a_run_for_workers_that_are_gone_does_not_wait_for_them(self) -> None:
        with distributed.LocalCluster(n_workers=2, processes=False, dashboard_address=None) as cluster, distributed.Client(cluster) as client:
            unfit, fit = sorted(client.scheduler_info()["workers"])
            executor = executors.Dask(client, MAX_S, MAX_S)
            self.assertTrue(executor.avoid(unfit))
            client.retire_workers([fit], close_workers=True)
            handle = executor.submit(cast(worker.Task, {"key": "0"}))
            over: set[Any] = set()
            until = time.monotonic() + MAX_S
            while time.monotonic() < until and not over:
                executor.look()
                over = executor.wait([handle], 0.1)
            self.assertEqual(over, {handle})
            with self.assertRaisesRegex(ps.StudyError, "the workers that it was for are gone"):
                executor.outcome(handle)

    def compare(self, study: ps.Study) -> None:
        """The same runs on this machine have the same rows."""
        local = ps.batch(self.graph, self.rows[:2], self.folder / "local", threads=1)
        own, other = (parquet.read_table(one.table / "runs.parquet").to_pylist()[:2] for one in (local, study))
        self.assertEqual(own, other)

    def test_ray_is_called_as_it_wants(self) -> None:
        study = ps.batch(self.graph, self.rows[:3], self.folder / "study", executor=FakeRay(), threads=1)
        self.assertEqual(dict(study.counts), {"done": 3, "open": 0})
        self.compare(study)

    def test_a_client_of_dask_is_an_executor(self) -> None:
        with distributed.LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster, distributed.Client(cluster) as client:
            study = ps.batch(self.graph, self.rows, self.folder / "study", executor=client, threads=1)
        self.assertEqual(dict(study.counts), {"done": RUNS, "open": 0}, study.notes)
        self.compare(study)

    def test_a_machine_without_a_plugin_is_told_from_one_with_another_build(self) -> None:
        (file,) = (COMMAND.parent / "plugins").glob("*flow*.so")
        plugins = [{"name": "flow", "file": str(file), "xxh3": "0" * 32}]
        self.assertIn("another build", worker._unfit(str(COMMAND.parent), json.dumps(plugins)))


if __name__ == "__main__":
    unittest.main()
