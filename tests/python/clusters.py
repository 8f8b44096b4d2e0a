"""Studies on a Dask cluster of processes: workers that are killed, hang, lack a plugin, and runs that take too much memory. Started by
tests/tests/batches.rs. `PANOSCOPE_BATCH_RUNS` sets the number of runs.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any

import distributed
import pyarrow.parquet as parquet
from PIL import Image

import panoscope as ps
from panoscope.studies import worker

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


class Clusters(unittest.TestCase):
    def setUp(self) -> None:
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)
        self.graph = self.folder / "graph.toml"
        self.graph.write_text(GRAPH)
        self.rows = [{"clip": self.picture(f"{number}.png", (32, 24), number % 200)} for number in range(RUNS)]
        self.workers: list[subprocess.Popen[bytes]] = []

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

    @unittest.skipUnless("PANOSCOPE_BATCH_RUNS" in os.environ, "four workers take some seconds to start: `cargo xtask test batches`")
    def test_a_study_survives_its_workers_and_names_each(self) -> None:
        rows = [*self.rows, {"clip": self.picture("large.png", (7000, 5000), 9)}]
        said: list[str] = []
        with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None, protocol="tcp", host="127.0.0.1") as cluster:
            with distributed.Client(cluster) as client:
                good, killed, hung = (self.worker(cluster.scheduler_address) for _ in range(3))
                self.worker(cluster.scheduler_address, PANOSCOPE_PROGRAM=str(self.other_installation()))
                client.wait_for_workers(4, MAX_S)

                def say(text: str) -> None:
                    if not said:
                        # Their first runs are about to be handed out.
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
