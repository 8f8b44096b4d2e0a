"""Runs the notebooks as Jupyter does. Started by tests/tests/python_host.rs."""

import os
import re
import tempfile
import unittest
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).resolve().parents[2] / "core/python"
LIMIT_S = 900
KEPT = os.environ.get("PANOSCOPE_NOTEBOOKS")
"""Folder for the notebooks with their outputs, to look at them."""


class Notebook(unittest.TestCase):
    def executed(self, name):
        """The outputs of a notebook, and all texts among them."""
        notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
        self.assertFalse(any(cell.get("outputs") for cell in notebook.cells), "the file is kept without outputs: clear them")
        with tempfile.TemporaryDirectory(prefix="panoscope-notebook-") as folder:
            os.environ["TMPDIR"] = folder
            NotebookClient(notebook, timeout=LIMIT_S, kernel_name="python3", resources={"metadata": {"path": folder}}).execute()
        if KEPT:
            nbformat.write(notebook, Path(KEPT) / name)
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
        return outputs, "\n".join(output.get("text", "") + output.get("data", {}).get("text/plain", "") for output in outputs)


def cells_of(outputs, head):
    """Rows of the table whose page has a column ``head``, as texts."""
    page = next(output["data"]["text/html"] for output in outputs if f"<th>{head}</th>" in output.get("data", {}).get("text/html", ""))
    return [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", page)][1:]


class Tutorial(Notebook):
    def test_every_cell_runs_and_shows_what_it_says(self):
        outputs, text = self.executed("tutorial.ipynb")
        pictures = [output for output in outputs if "image/png" in output.get("data", {})]
        self.assertEqual(len(pictures), 2, "the left view and the coloured depth")
        depth_mm, known = map(float, re.search(r"median depth ([\d.]+) mm, known ([\d.]+) %", text).groups())
        self.assertTrue(40 < depth_mm < 60 and known > 60, text)
        # Both matchers were at work in one run; that of the notebook knows the scene.
        for name in ("stereo_bm", "mean_difference"):
            self.assertRegex(text, rf"'{name}': '\d")
        values = re.findall(r"'(?:stereo_bm|mean_difference)': '([\d.]+) %", text)
        self.assertEqual((len(values), len(set(values))), (2, 2), "each matcher has its own value")
        self.assertEqual(len(re.findall(r"^stereo_s?g?bm +\d+ px +bad-2 +[\d.]+ %", text, re.M)), 6, text)
        self.assertIn("report.html", text)


class OwnData(Notebook):
    def test_every_layout_gives_the_same_figures(self):
        outputs, text = self.executed("own_data.ipynb")
        self.assertRegex(text, r"6 pairs, \d+ boxes of \w+")
        self.assertIn("KITTI stereo 2015", text)
        rows = cells_of(outputs, "matcher")
        self.assertEqual([row[0] for row in rows[::2]], ["pairs", "kitti", "middlebury 0", "middlebury 1"])
        self.assertEqual([row[2] for row in rows], ["6", "6", "6", "6", "1", "1", "1", "1"])
        for row in rows:
            bad2_pct, mean_px, coverage_pct = map(float, row[3:])
            self.assertTrue(0 < bad2_pct < 60 and 0 < mean_px < 5 and coverage_pct > 50, row)
        for plain, kitti in zip(rows[:2], rows[2:4]):
            # KITTI's disparities are rounded to 1/256 px.
            for one, other in zip(plain[3:], kitti[3:]):
                self.assertAlmostEqual(float(one), float(other), delta=0.05)
        figures = {row[0]: float(row[1]) for row in cells_of(outputs, "figure")}
        self.assertTrue(any("map50" in name.lower() or "ap50" in name.lower() for name in figures), figures)
        self.assertIn("\ndone\n", text)


class OwnNetwork(Notebook):
    def test_a_network_and_a_class_of_a_cell_run_beside_a_matcher(self):
        outputs, text = self.executed("own_network.ipynb")
        figures = {row[0]: list(map(float, row[1:])) for row in cells_of(outputs, "map")}
        self.assertEqual(list(figures), ["network", "blocks", "ours", "shipped", "both"])
        for bad2_pct, mean_px, coverage_pct in figures.values():
            self.assertTrue(0 < bad2_pct < 80 and 0 < mean_px < 20 and coverage_pct > 20, figures)
        # What both agree on is less, and better, than either.
        self.assertLess(figures["both"][2], figures["ours"][2])
        self.assertLess(figures["both"][1], min(figures["ours"][1], figures["network"][1]))
        # The network that ships fills what its hint leaves open.
        self.assertGreater(figures["shipped"][2], 99)
        self.assertEqual(text.split("\n")[-4:], ["consensus_node.py", "own_network.toml", "stereo.onnx", ""])


if __name__ == "__main__":
    unittest.main()
