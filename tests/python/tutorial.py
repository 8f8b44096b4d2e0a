"""Runs the tutorial notebook as Jupyter does. Started by tests/tests/python_host.rs."""

import os
import re
import tempfile
import unittest
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[2] / "core/python/tutorial.ipynb"
LIMIT_S = 900


class Tutorial(unittest.TestCase):
    def test_every_cell_runs_and_shows_what_it_says(self):
        notebook = nbformat.read(NOTEBOOK, as_version=4)
        self.assertFalse(any(cell.get("outputs") for cell in notebook.cells), "the file is kept without outputs: clear them")
        with tempfile.TemporaryDirectory(prefix="panoscope-tutorial-") as folder:
            os.environ["TMPDIR"] = folder
            NotebookClient(notebook, timeout=LIMIT_S, kernel_name="python3", resources={"metadata": {"path": folder}}).execute()
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
        pictures = [output for output in outputs if "image/png" in output.get("data", {})]
        self.assertEqual(len(pictures), 2, "the left view and the coloured depth")
        text = "\n".join(output.get("text", "") + output.get("data", {}).get("text/plain", "") for output in outputs)
        depth_mm, known = map(float, re.search(r"median depth ([\d.]+) mm, known ([\d.]+) %", text).groups())
        self.assertTrue(40 < depth_mm < 60 and known > 60, text)
        # Both matchers were at work in one run; that of the notebook knows the scene.
        for name in ("stereo_bm", "mean_difference"):
            self.assertRegex(text, rf"'{name}': '\d")
        values = re.findall(r"'(?:stereo_bm|mean_difference)': '([\d.]+) %", text)
        self.assertEqual((len(values), len(set(values))), (2, 2), "each matcher has its own value")
        self.assertEqual(len(re.findall(r"^stereo_s?g?bm +\d+ px +bad-2 +[\d.]+ %", text, re.M)), 6, text)
        self.assertIn("report.html", text)


if __name__ == "__main__":
    unittest.main()
