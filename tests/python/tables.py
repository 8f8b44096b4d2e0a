"""Results of runs as tables of pandas, Polars and Arrow. Started by tests/tests/live.rs."""

import os
import subprocess
import tempfile
import unittest
import unittest.mock
from pathlib import Path

import numpy as np
import pandas
import polars
import pyarrow.parquet

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
GRAPH = """
mode = "batch"
plugins = ["phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120, tools = 2 }
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
params = { search_px = 32 }
[nodes.judge]
type = "evaluate_disparity"
inputs = { disparity = "match.disparity", truth = "scope.disparity" }
"""


class Tables(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.folder = tempfile.TemporaryDirectory()
        path = Path(cls.folder.name) / "graph.toml"
        path.write_text(GRAPH)
        watch = ["scope.left", "scope.lead", "scope.detections", "judge.table"]
        cls.result = ps.Graph(path).run(frames=5, watch=watch)

    @classmethod
    def tearDownClass(cls) -> None:
        cls.folder.cleanup()

    def test_records_have_a_row_per_tick(self) -> None:
        series = self.result["scope.lead"]
        table = series.to_pandas()
        self.assertIsInstance(table, pandas.DataFrame)
        self.assertEqual(list(table["tick"]), list(series.ticks))
        for index, tip in enumerate(series):
            self.assertEqual(table["u_px"][index], tip["u_px"])
            self.assertEqual(table["xyz_mm[2]"][index], tip["xyz_mm"][2])

    def test_boxes_have_a_row_each(self) -> None:
        series = self.result["scope.detections"]
        table = series.to_polars()
        self.assertIsInstance(table, polars.DataFrame)
        self.assertEqual(len(table), sum(len(value.boxes) for value in series))
        first = series[0]
        self.assertEqual(table["label"][0], first.labels[int(first.boxes[0]["class_index"])])

    def test_tables_keep_their_columns(self) -> None:
        series = self.result["judge.table"]
        columns = series[0].columns
        self.assertTrue(set(columns) <= set(series.to_pandas().columns), columns)

    def test_all_outputs_together_are_written_as_parquet(self) -> None:
        path = Path(self.folder.name) / "all.parquet"
        pyarrow.parquet.write_table(self.result.to_arrow(), path)
        read = pandas.read_parquet(path)
        self.assertEqual(set(read["output"]), {"scope.lead", "scope.detections", "judge.table"})
        self.assertEqual((read["output"] == "scope.lead").sum(), 5)
        self.assertTrue(np.isfinite(read["capture_ns"]).all())

    def test_every_table_becomes_parquet(self) -> None:
        folder = Path(self.folder.name)
        graph = ps.Graph(folder / "graph.toml")
        rows = ps.sweep(graph, {"match.search_px": [32, 64]}, ["judge.bad2_pct"], frames=2)
        rows.to_parquet(folder / "sweep.parquet")
        self.assertEqual(list(pandas.read_parquet(folder / "sweep.parquet")["match.search_px"]), [32, 64])
        self.result.nodes().to_parquet(folder / "nodes.parquet")
        nodes = pandas.read_parquet(folder / "nodes.parquet").set_index("node")
        self.assertEqual((set(nodes.index), nodes["count"]["match"]), ({"scope", "match", "judge"}, 5))
        graph.record(folder / "a.mcap", all_ports=True).run(frames=3, watch=["judge.table"])
        files = ps.Recording(folder / "a.mcap").to_parquet(folder / "parquet")
        table = pandas.read_parquet(folder / "parquet" / "judge.table.parquet")
        self.assertIn(folder / "parquet" / "judge.table.parquet", files)
        self.assertFalse((folder / "parquet" / "scope.left.parquet").exists())
        self.assertEqual(list(table["tick"]), [0, 1, 2])
        self.assertLessEqual(set(self.result["judge.table"][0].columns), set(table.columns))

    def test_files_of_tables_are_read(self) -> None:
        folder = Path(self.folder.name)
        graph = ps.Graph(folder / "graph.toml")
        built = ps.Graph(mode="batch", name="written")
        views = built.phantom(width=160, height=120, tools=2)
        match = built.stereo_bm(views.left, views.right, search_px=32)
        judge = built.evaluate_disparity(disparity=match.disparity, truth=views.disparity)
        for ending in ("csv", "jsonl"):
            built.write_table(judge.table, path=folder / f"table.{ending}")
        tables = built.run(frames=3, watch=[judge.table], act=True)[judge.table]
        for ending in ("csv", "jsonl"):
            rows = ps.read_table(folder / f"table.{ending}")
            self.assertEqual(len(rows), len(tables))
            for row, table in zip(rows, tables):
                for column, value in zip(table.columns, table.rows[0]):
                    np.testing.assert_allclose(row[column], value, rtol=1e-3, err_msg=column)
            rows.to_parquet(folder / "table.parquet")
            self.assertEqual(len(pandas.read_parquet(folder / "table.parquet")), 3)
        report = folder / "report.json"
        subprocess.run([COMMAND, "run", graph.path, "--headless", "--frames", "2", "--report", report], check=True, capture_output=True)
        self.assertEqual({row["node"] for row in ps.read_table(report)}, {"scope", "match", "judge"})
        report.write_text("[1, 2]")
        with self.assertRaisesRegex(ValueError, "is not a table"):
            ps.read_table(report)

    def test_a_missing_package_is_named_with_the_remedy(self) -> None:
        rows = ps.Rows([{"a": 1.0}, {"a": "text", "b": True}])
        self.assertEqual(rows.to_arrow().to_pydict(), {"a": ["1.0", "text"], "b": [None, True]})
        with unittest.mock.patch.dict("sys.modules", {"pyarrow": None, "pyarrow.parquet": None}):
            with self.assertRaisesRegex(ImportError, "a Parquet file needs pyarrow.* -m pip install pyarrow"):
                rows.to_parquet("a.parquet")

    def test_pixels_are_refused(self) -> None:
        with self.assertRaisesRegex(TypeError, "numpy.asarray"):
            self.result["scope.left"].to_pandas()


if __name__ == "__main__":
    unittest.main()
