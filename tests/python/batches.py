"""Studies: a graph over many inputs, stopped and killed at any moment, and what is said about them. Started by tests/tests/batches.rs.

`PANOSCOPE_BATCH_KILLS` sets the number of kills of the campaign, `PANOSCOPE_BATCH_SEED` other moments.
"""

import csv
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path
from typing import Any, Optional
from unittest import mock

import fsspec
import polars
import pyarrow.parquet as parquet
from PIL import Image

import panoscope as ps
from panoscope.studies import plan, process, statistics, table, values, worker
from panoscope.studies.store import Store

COMMAND = os.environ["PANOSCOPE_BIN"]
KILLS = int(os.environ.get("PANOSCOPE_BATCH_KILLS", "2"))
SEED = int(os.environ.get("PANOSCOPE_BATCH_SEED", "1"))
MAX_S = 120.0
GRAPH = """
name = "tiny"
mode = "batch"
plugins = ["capture", "flow", "sinks"]
[args.clip]
type = "source"
[args.again]
type = "flag"
default = false
[nodes.views]
type = "capture"
params = { left = { arg = "clip" }, loop = { arg = "again" } }
[nodes.light]
type = "level"
inputs = { image = "views.left" }
[nodes.rows]
type = "write_table"
inputs = { table = "light.levels" }
params = { path = "out/levels.csv" }
"""


class Case(unittest.TestCase):
    def setUp(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.addCleanup(self._folder.cleanup)
        self.folder = Path(self._folder.name)
        self.graph = self.folder / "tiny.toml"
        self.graph.write_text(GRAPH)

    def clip(self, number: int, light: Optional[int] = None) -> str:
        """A folder of three pictures, as a pattern."""
        folder = self.folder / "clips" / str(number)
        folder.mkdir(parents=True, exist_ok=True)
        for tick in range(3):
            Image.new("L", (32, 24), 10 * number + tick if light is None else light).save(folder / f"{tick}.png")
        return str(folder / "*.png")

    def table(self, clips: int) -> Path:
        file = self.folder / "inputs.csv"
        with file.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["clip", "patient"])
            writer.writerows((self.clip(number), f"p{number % 3}") for number in range(1, clips + 1))
        return file

    def batch(self, out: str, rows: Any, **options: Any) -> ps.Study:
        return ps.batch(self.graph, rows, self.folder / out, **{"threads": 1, "progress": False, **options})

    def rows(self, out: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = parquet.read_table(self.folder / out / "table" / "runs.parquet").to_pylist()
        return found


class Plans(Case):
    def names(self, *names: str) -> None:
        for name in names:
            file = self.folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(name)

    def test_patterns_pair_the_views_of_a_clip(self) -> None:
        self.names("a/1_left.mkv", "a/1_right.mkv", "b/1_left.mkv", "b/1_right.mkv", "b/2_left.mkv", "b/2_right.mkv")
        known = [plan.Argument("left", "source", True), plan.Argument("right", "source", True)]
        rows = plan.rows_of(f"{self.folder}/{{operation}}/{{clip}}_left.mkv", known)
        self.assertEqual([(row["operation"], row["clip"]) for row in rows], [("a", "1"), ("b", "1"), ("b", "2")])
        self.assertTrue(all(row["right"] == row["left"].replace("left", "right") for row in rows))
        by_argument = plan.inputs_of_words([f"{view}={self.folder}/{{operation}}/{{clip}}_{view}.mkv" for view in ("left", "right")], known)
        self.assertEqual(plan.rows_of(by_argument, known), rows)
        (self.folder / "b/2_right.mkv").unlink()
        with self.assertRaisesRegex(ps.StudyError, "1 files have no partner: .*b/2_left.mkv"):
            plan.rows_of(by_argument, known)
        with self.assertRaisesRegex(ps.StudyError, "no file is named like"):
            plan.rows_of({"left": f"{self.folder}/{{clip}}.mp4"}, known)

    def test_the_same_values_are_the_same_run_in_any_row(self) -> None:
        known = [plan.Argument("seed", "whole", False)]
        sweep = values.combinations({"light.gain": (1, 2, 3)})
        self.assertEqual(sweep, [{"light.gain": 1.0}, {"light.gain": 1.5}, {"light.gain": 2.0}])
        one = plan.runs_of([{"seed": "1", "patient": "a"}, {"seed": "2", "patient": "b"}], known, {}, sweep)
        two = plan.runs_of([{"seed": "2", "patient": "b"}, {"seed": "1", "patient": "c"}], known, {}, sweep)
        self.assertEqual({run.key for run in one}, {run.key for run in two})
        self.assertEqual(len({run.key for run in one}), 6)
        with self.assertRaisesRegex(ps.StudyError, "rows 1 and 3 are the same run"):
            plan.runs_of([{"seed": "1"}, {"seed": "2"}, {"seed": "1"}], known, {}, [{}])

    def test_mistakes_are_named_before_anything_runs(self) -> None:
        rows = [{"clip": self.clip(1)}]
        for given, options, message in (
            ([], {}, "no input"),
            ([{"patient": "p1"}], {}, "the graph needs the arguments clip: the table has the columns patient"),
            ([{"clip": ""}], {}, "`clip` is empty in rows 1"),
            ([{**rows[0], "status": "healthy"}], {}, "`status` is a column that results have"),
            (rows, {"sweep": {"light.gain": [99]}}, "gain"),
            (rows, {"sweep": {"light.gain": (1, 2)}}, "from, to, steps"),
            (rows, {"args": {"clip": "a.mkv"}}, "leave one of them out"),
            (rows, {"executor": "spark"}, "tcp://HOST:PORT"),
        ):
            with self.assertRaisesRegex(ps.PanoscopeError, message):
                self.batch("study", given, **options)
        self.assertFalse((self.folder / "study" / "runs").exists())


class Runs(Case):
    def test_the_number_of_frames_is_a_maximum(self) -> None:
        self.assertEqual(self.batch("short", self.table(1), frames=2).counts["done"], 1)
        self.assertEqual(self.batch("long", self.table(1), frames=5).counts["done"], 1, "a clip of three frames")
        self.assertEqual([self.rows(out)[0]["frames"] for out in ("short", "long")], [2, 3])

    def test_a_run_is_done_once_and_again_when_what_it_depends_on_changes(self) -> None:
        options = {"sweep": {"light.gain": [1.0, 2.0]}, "ticks": True}
        study = self.batch("study", self.table(2), **options)
        self.assertEqual(study.counts["done"], 4, study.failures)
        rows = self.rows("study")
        self.assertEqual([(row["patient"], row["light.gain"]) for row in rows], [("p1", 1.0), ("p1", 2.0), ("p2", 1.0), ("p2", 2.0)])
        self.assertEqual([row["light.level.mean"] for row in rows], [11.0, 22.0, 21.0, 42.0])
        self.assertTrue(all(row["status"] == "done" and row["frames"] == 3 and row["light.level.count"] == 3 for row in rows))
        self.assertTrue(all(rows[0][name] for name in plan.HASHES))
        self.assertNotEqual(rows[0]["inputs_hash"], rows[2]["inputs_hash"])
        ticks = parquet.read_table(study.table / "ticks.parquet")
        self.assertEqual((ticks["tick"].to_pylist()[:3], ticks["light.level"].to_pylist()[:6]), ([0, 1, 2], [10.0, 11.0, 12.0, 20.0, 22.0, 24.0]))
        # What the sink wrote is with the run, not where the graph says.
        self.assertEqual(rows[0]["files"], ["files/out/levels.csv"])
        self.assertEqual(len((Store(study.folder).run(rows[0]["run"]) / rows[0]["files"][0]).read_text().splitlines()), 4)
        self.assertFalse((self.folder / "out").exists())
        before = (study.table / "runs.parquet").read_bytes()
        self.assertEqual(dict(self.batch("study", self.table(2), **options).counts), {"kept": 4, "open": 0})
        self.assertEqual((study.table / "runs.parquet").read_bytes(), before)
        dry = self.batch("study", self.table(3), **options, dry_run=True)
        self.assertEqual(dict(dry.counts), {"kept": 4, "open": 2})
        # Other bytes of an input repeat its runs, the same bytes with another time do not.
        rows = self.table(2)
        self.clip(2, 77)
        changed = self.batch("study", rows, **options)
        self.assertEqual(dict(changed.counts), {"kept": 2, "done": 2, "open": 0})
        self.assertEqual(self.rows("study")[3]["light.level.mean"], 154.0)
        self.graph.write_text(GRAPH + "# a remark\n")
        dry = self.batch("study", rows, **options, dry_run=True)
        self.assertEqual(dict(dry.counts), {"open": 4})

    def test_failed_runs_are_listed_hide_no_others_and_are_retried(self) -> None:
        lost = self.clip(2)
        rows = [{"clip": lost}, {"clip": self.clip(1)}, {"clip": self.clip(3)}]
        shutil.rmtree(Path(lost).parent)
        study = self.batch("study", rows)
        self.assertEqual((study.counts["done"], study.counts["failed"]), (2, 1))
        (error,) = study.failures.values()
        self.assertIn("error", error)
        failed = self.rows("study")[0]
        self.assertEqual((failed["status"], failed["error"]), ("failed", error))
        self.clip(2)
        self.assertEqual(dict(self.batch("study", rows).counts), {"kept": 2, "failed": 1, "open": 0})
        self.assertEqual(dict(self.batch("study", rows, retry=True).counts), {"kept": 2, "done": 1, "open": 0})
        self.assertEqual([row["status"] for row in self.rows("study")], ["done"] * 3)

    def test_measures_are_outputs_columns_and_numbers_of_nodes(self) -> None:
        self.batch("study", self.table(1), measures=["light.levels.max", "rows.lines", "light.level"])
        (row,) = self.rows("study")
        self.assertEqual([name[: -len(".last")] for name in row if name.endswith(".last")], ["light.level", "light.levels.max", "rows.lines"])
        self.assertEqual((row["light.levels.max.last"], row["rows.lines.last"]), (12.0, 3.0))
        for measure, message in (("lihgt.level", "no node `lihgt`; its nodes are"), ("views.left", "carries image, which has no numbers"), ("level", "write it as")):
            study = self.batch("wrong", self.table(1), measures=[measure])
            self.assertIn(message, min(study.failures.values()))

    def test_limits_of_time_and_memory_end_a_run_and_are_named(self) -> None:
        rows = [{"clip": self.clip(1), "again": True}]
        study = self.batch("long", rows, max_s=0.4)
        self.assertIn("longer than the limit of 0.4 s", min(study.failures.values()))
        study = self.batch("large", rows, max_memory_mb=4)
        self.assertIn("more memory than the limit of 4 MB", min(study.failures.values()))

    def test_inputs_of_stores_are_copied_for_their_run_and_hashed(self) -> None:
        system = fsspec.filesystem("memory")
        self.addCleanup(system.rm, "/archive", recursive=True)

        def put(operation: int, light: int) -> None:
            stream = io.BytesIO()
            Image.new("L", (32, 24), light).save(stream, "PNG")
            system.pipe(f"/archive/{operation}/clip.png", stream.getvalue())

        for operation in (1, 2):
            put(operation, 10 * operation)
        inputs = {"clip": "memory://archive/{operation}/clip.png"}
        study = self.batch("study", inputs)
        self.assertEqual(dict(study.counts), {"done": 2, "open": 0}, study.failures)
        rows = self.rows("study")
        self.assertEqual([(row["operation"], row["light.level.mean"]) for row in rows], [(1, 10.0), (2, 20.0)])
        self.assertNotEqual(rows[0]["inputs_hash"], rows[1]["inputs_hash"])
        # No copy stays.
        self.assertEqual([file.name for file in study.folder.rglob("clip.png")], [])
        put(2, 77)
        self.assertEqual(dict(self.batch("study", inputs).counts), {"kept": 1, "done": 1, "open": 0})
        self.assertEqual([row["light.level.mean"] for row in self.rows("study")], [10.0, 77.0])
        # The same bytes have the same hash wherever they are.
        system.get("/archive/1/clip.png", str(self.folder / "clip.png"))
        local = self.batch("local", {"clip": f"file://{self.folder}/{{name}}.png"})
        self.assertEqual(dict(local.counts), {"done": 1, "open": 0}, local.failures)
        self.assertEqual(self.rows("local")[0]["inputs_hash"], rows[0]["inputs_hash"])
        system.rm("/archive/2", recursive=True)
        study = self.batch("study", [{"clip": f"memory://archive/{operation}/clip.png"} for operation in (1, 2)])
        self.assertEqual((study.counts["kept"] + study.counts["done"], study.counts["failed"]), (1, 1))
        self.assertIn("archive/2/clip.png", min(study.failures.values()))

    def test_the_next_run_is_prepared_while_one_goes_on(self) -> None:
        prepared, going = threading.Semaphore(0), [0, 0]
        hash_of_inputs, run = worker.hash_of_inputs, process.run

        def hashed(paths: Any) -> str:
            prepared.release()
            return hash_of_inputs(paths)

        def ran(*arguments: Any) -> process.Ended:
            going[0] += 1
            going[1] = max(going)
            # The first run waits for its own inputs and for those of the second.
            if not started:
                started.append(True)
                self.assertTrue(all(prepared.acquire(timeout=MAX_S) for _ in range(2)))
            ended = run(*arguments)
            going[0] -= 1
            return ended

        started: list[bool] = []
        with mock.patch.object(worker, "hash_of_inputs", hashed), mock.patch.object(process, "run", ran):
            study = self.batch("study", self.table(3), jobs=1)
        self.assertEqual((study.counts["done"], going), (3, [0, 1]), study.notes)

    def test_a_run_of_a_killed_driver_ends_with_it(self) -> None:
        words = [COMMAND, "run", str(self.graph), "--clip", self.clip(1), "--again=true", "--headless", "--unpaced"]
        driver = f"from panoscope.studies import process; from pathlib import Path; process.run({words!r}, Path({str(self.folder / 'log')!r}), 100)"
        with subprocess.Popen([sys.executable, "-c", driver]) as parent:
            children = _wait_for(lambda: process._children(parent.pid))
            # It has asked to end with its parent before it writes.
            _wait_for(lambda: (self.folder / "out/levels.csv").exists())
            parent.kill()
            parent.wait()
            _wait_for(lambda: not any(_is_alive(child) for child in children))

    def test_what_a_killed_driver_leaves_is_removed(self) -> None:
        rows = [{"clip": self.clip(1)}]
        for call, place in (("replace", "study.json"), ("rename", "/runs/"), ("replace", "runs.parquet")):
            dying = f"import os; real = os.{call}; os.{call} = lambda one, two: os._exit(9) if {place!r} in str(two) else real(one, two)"
            run = f"{dying}; import panoscope as ps; ps.batch({str(self.graph)!r}, {rows!r}, {str(self.folder / 'study')!r}, threads=1)"
            self.assertEqual(subprocess.run([sys.executable, "-c", run]).returncode, 9, place)
        study = self.batch("study", rows)
        self.assertEqual(study.counts["kept"], 1)
        self.assertEqual(list((study.folder / "tmp").iterdir()), [])
        self.assertEqual([file.name for file in study.folder.rglob("*") if "part" in file.name], [])

    def test_two_drivers_do_not_share_a_study(self) -> None:
        with Store(self.folder / "study").lock(), self.assertRaisesRegex(ps.StudyError, f"is being run by process {os.getpid()}"):
            self.batch("study", self.table(1))


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _wait_for(condition: Any) -> Any:
    until = time.monotonic() + MAX_S
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.005)
    raise AssertionError("it did not happen in time")


class Kills(Case):
    """Driver and runs die by kill -9 at random moments; the table of the study that was resumed has the bytes of one that nothing disturbed."""

    def setUp(self) -> None:
        super().setUp()
        self.clips = self.table(4)

    def command(self, out: str) -> list[str]:
        return [COMMAND, "batch", str(self.graph), "--inputs", str(self.clips), "-o", str(self.folder / out), "--param", "light.gain=1,2", "--ticks",
                "--threads=1", "--jobs=2"]  # fmt: skip

    def run_once(self, out: str, after_s: float, kills_driver: bool, chance: random.Random) -> int:
        """Starts the batch and kills it, or one of its runs, after a while; returns its exit code."""
        with subprocess.Popen(self.command(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as driver:
            time.sleep(after_s)
            runs = process._children(driver.pid)
            target = driver.pid if kills_driver or not runs else chance.choice(runs)
            try:
                os.kill(target, signal.SIGKILL)
            except ProcessLookupError:
                pass
            return driver.wait(MAX_S)

    def test_the_table_is_that_of_an_undisturbed_study(self) -> None:
        chance = random.Random(SEED)
        began = time.monotonic()
        subprocess.run(self.command("calm"), check=True, capture_output=True)
        length_s = time.monotonic() - began
        tables = [Path("table") / name for name in ("runs.parquet", "ticks.parquet")]
        for kill in range(KILLS):
            if self.run_once("shaken", chance.uniform(0.1, 1.0) * length_s, kill % 3 != 2, chance) == 0 and kill + 1 < KILLS:
                # It is done: the next kills hit another study.
                self.assertEqual([(self.folder / "shaken" / name).read_bytes() for name in tables], [(self.folder / "calm" / name).read_bytes() for name in tables])
                Store(self.folder / "shaken").discard(self.folder / "shaken" / "runs")
        subprocess.run(self.command("shaken"), check=True, capture_output=True)
        for name in tables:
            self.assertEqual((self.folder / "shaken" / name).read_bytes(), (self.folder / "calm" / name).read_bytes(), name)
        self.assertEqual(list((self.folder / "shaken" / "tmp").iterdir()), [])
        self.assertFalse((self.folder / "shaken" / "failed").exists() and any((self.folder / "shaken" / "failed").rglob("result.json")))


class Reports(Case):
    def study(self, out: str, shift: float) -> Path:
        chance = random.Random(3)
        rows = []
        for number in range(200):
            row = {"run": f"{number:016x}", "number": number + 1, "status": "done", "error": None, "patient": f"p{number % 4}", "files": []}
            value = chance.gauss(10.0, 2.0)
            rows.append({**row, "judge.bad2_pct.mean": value + shift + chance.gauss(0.0, 0.1), "judge.bad2_pct.count": 20})
        rows[7] = {**rows[7], "status": "failed", "error": "error: <no> camera", "judge.bad2_pct.mean": None}
        folder = self.folder / out
        table.write_rows(rows, Store(folder), table.RUNS_FILE)
        (folder / "study.json").write_text(json.dumps({"graph": "g.toml", "columns": ["patient"], "sweep": {}, "hashes": {}}))
        return folder

    def test_means_have_their_intervals_and_pairs_show_small_differences(self) -> None:
        first, second = statistics.Table(self.study("first", 0.0)), statistics.Table(self.study("second", 0.1))
        measure = "judge.bad2_pct"
        found = statistics.Measure(first, measure, ["patient"])
        summary = found.summary()
        column = polars.read_parquet(first.file).filter(polars.col("status") == "done")[f"{measure}.mean"]
        self.assertEqual(summary.interval.count, 199)
        self.assertAlmostEqual(summary.interval.mean, column.mean(), 9)
        self.assertAlmostEqual(summary.interval.half_width, 1.97202 * column.std() / 199**0.5, 4)
        pair = statistics.Pairs(first, second).compare(measure, False)
        # By itself each mean is too uncertain.
        self.assertLess(abs(pair.difference.mean), summary.interval.half_width)
        self.assertTrue(pair.is_significant)
        self.assertFalse(statistics.Pairs(first, first).compare(measure, False).is_significant)
        self.assertEqual([group.group for group in found.groups()], [(f"p{number}",) for number in range(4)])
        self.assertEqual(sum(group.interval.count for group in found.groups()), 199)
        low, high, counts = found.histogram()
        self.assertEqual((low, high, sum(counts)), (column.min(), column.max(), 199))
        self.assertEqual(counts[0], sum(value < low + (high - low) / 40 for value in column))
        self.assertAlmostEqual(summary.median, column.median(), 12)
        worst = found.worst(3, False)
        self.assertEqual([row["value"] for row in worst], sorted(column, reverse=True)[:3])
        rows = {row["run"]: row for row in polars.read_parquet(first.file).to_dicts()}
        self.assertTrue(all(rows[row["run"]][f"{measure}.mean"] == row["value"] for row in worst))
        # Also where the runs stand in another order.
        frame = polars.read_parquet(second.file)
        frame.sort(f"{measure}.mean", descending=True).drop("number").with_row_index("number", 1).write_parquet(second.file)
        joined = statistics.Pairs(first, statistics.Table(second.folder)).compare(measure, False)
        self.assertAlmostEqual(joined.difference.half_width, pair.difference.half_width, 9)
        self.assertEqual((joined.difference.count, joined.better_share), (199, pair.better_share))

    def test_quantiles_of_students_distribution(self) -> None:
        for freedom, quantile in ((1, 12.7062), (4, 2.7764), (5, 2.5706), (9, 2.2622), (29, 2.0452), (199, 1.97196), (10**7, 1.95996)):
            self.assertAlmostEqual(statistics.t_975(freedom), quantile, 3)

    def test_a_page_needs_nothing_else(self) -> None:
        page = ps.report([self.study("first", 0.0), self.study("second", 0.5)], self.folder / "page.html", by=["patient"])
        text = page.read_text()
        self.assertNotIn("http", text.replace('charset="utf-8"', ""))
        self.assertNotIn("<script", text)
        for words in ("better", "worse", "&lt;no&gt; camera", "judge.bad2_pct", "<svg", "p3", "second/runs/"):
            if words != "better":
                self.assertIn(words, text)

    def test_the_worst_runs_are_recorded_again(self) -> None:
        self.batch("study", self.table(2), sweep={"light.gain": [1.0, 2.0]})
        page = subprocess.run([COMMAND, "report", str(self.folder / "study"), "--html", str(self.folder / "page.html")], capture_output=True, text=True)
        self.assertEqual(page.returncode, 0, page.stderr)
        words = ["worst", str(self.folder / "study"), "--measure", "light.level", "-n", "1", "--record"]
        run = subprocess.run([COMMAND, *words], capture_output=True, text=True)
        self.assertEqual(run.returncode, 0, run.stderr)
        recording = ps.Recording(run.stdout.split()[-1])
        row = max(self.rows("study"), key=lambda row: row["light.level.mean"])
        levels = [scalar for scalar in recording["light.level"]]
        self.assertEqual(len(levels), 3)
        self.assertAlmostEqual(float(sum(levels)) / 3, row["light.level.mean"], 9)


if __name__ == "__main__":
    unittest.main()
