"""Results of runs as tables of pandas, Polars and Arrow. Started by tests/tests/live.rs."""

import tempfile
import unittest
from pathlib import Path

import numpy as np
import pandas
import polars
import pyarrow.parquet

import panoscope as ps

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

    def test_pixels_are_refused(self) -> None:
        with self.assertRaisesRegex(TypeError, "numpy.asarray"):
            self.result["scope.left"].to_pandas()


if __name__ == "__main__":
    unittest.main()
