"""The types of the Python package, as mypy and pyright see them: the package itself, and code that uses it. Started by tests/tests/live.rs.

pyright is basedpyright with the rules of pyright: its package has all that it needs, where that of pyright fetches itself when it is first run.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import panoscope as ps

PACKAGE = Path(ps.__file__).parent
GOOD = '''
from pathlib import Path

import numpy as np
import panoscope as ps


@ps.node(family="filter")
class Brighter:
    """Adds light."""

    light: int = ps.param(10, range=(0, 255))

    def process(self, image: ps.Gray8, mask: ps.Mask, tip: ps.Tip, boxes: ps.Detections, rows: ps.Table) -> ps.Gray8:
        bright: ps.Gray8 = np.minimum(image, 255 - self.light) + self.light
        return bright


def of_run(path: Path) -> float:
    result = ps.Graph(path).run(frames=20, watch=["scope.left"])
    return float(result["scope.left"].ages_ms.mean())


def built(path: Path) -> float:
    graph = ps.Graph(mode="batch", args={"left": "left.mp4"})
    views = graph.capture(left=graph.arg("left", "source"), right="right.mp4", loop=True)
    match = graph.stereo_bm(views.left, views.right, search_px=128, device="cpu", on_fault="stop")
    smooth = graph.disparity_wls(views.left.aligned("latest", max_age_ms=80), match.disparity, lambda_=1000)
    graph.overlay(graph.add("my_filter", views.left, strength=2).image)
    graph.side_by_side([views.left, views.right])
    graph.pass_(graph.output("later.image").aligned(delay=1))
    graph.save(path)
    rows: ps.Rows = ps.sweep(graph, "stereo_bm.search_px", match.drifted, start=64, stop=128)
    return float(graph.run(watch=[smooth.disparity])[smooth.disparity].ages_ms.mean()) + len(rows)


def of_recording(path: Path) -> int:
    return len(ps.Recording(path)["scope.left"].stack())
'''
WRONG = '''
import panoscope as ps

ps.Graph("a.toml").run(frame=20)
ps.log(1)
graph = ps.Graph()
views = graph.capture(left="left.mp4", right="right.mp4")
views.lefft
graph.stero_bm(views.left, views.right)
graph.stereo_bm(views.left, views.right, serch_px=128)
graph.stereo_bm(views.left, views.right, search_px="many")
graph.stereo_bm(views.left, views.calibration)
graph.stereo_bm(views.left)
graph.stereo_bm(views.left, views.right, device="cgpu")
'''
WRONG_LINES = [4, 5, 8, 9, 10, 11, 12, 13, 14]


def mypy(*files: Path) -> list[tuple[str, int, str]]:
    """Its mistakes: file, line from 1, message. One call for all files, because mypy reads NumPy each time."""
    # What it has read stays for the next run of the tests.
    cache = Path(os.environ["PANOSCOPE_PYTHON_PEERS"]) / ".mypy_cache"
    words = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", cache, "--no-error-summary", "--show-absolute-path", *files]
    # The folder of the peers has packages that mypy need not read.
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "MYPYPATH": str(PACKAGE.parent)})
    assert done.returncode in (0, 1), done.stdout + done.stderr
    found = [line.split(":", 2) for line in done.stdout.splitlines() if ": error:" in line]
    return [(file, int(line), message) for file, line, message in found]


def pyright(folder: Path, *files: Path) -> list[tuple[str, int, str]]:
    """Its mistakes: file, line from 1, message."""
    places = [str(PACKAGE.parent), *os.environ["PYTHONPATH"].split(os.pathsep)]
    config = folder / "pyrightconfig.json"
    config.write_text(json.dumps({"include": [str(file) for file in files], "typeCheckingMode": "standard", "extraPaths": places}))
    done = subprocess.run([sys.executable, "-m", "basedpyright", "-p", config, "--outputjson"], capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found["summary"]["filesAnalyzed"] > 0, done.stdout
    return [(one["file"], one["range"]["start"]["line"] + 1, one["message"]) for one in found["generalDiagnostics"] if one["severity"] == "error"]


class Types(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        self.good, self.wrong = self.folder / "good.py", self.folder / "wrong.py"
        self.good.write_text(GOOD)
        self.wrong.write_text(WRONG)

    def check(self, found: list[tuple[str, int, str]]) -> None:
        """Nothing but the lines that are wrong."""
        # By its name: mypy gives an unchanged file the path where it first read it.
        self.assertEqual([one for one in found if Path(one[0]).name != self.wrong.name], [])
        self.assertEqual(sorted({line for _, line, _ in found}), WRONG_LINES, found)

    def test_mypy_finds_what_is_wrong_and_nothing_else(self) -> None:
        self.assertTrue((PACKAGE / "py.typed").exists())
        self.check(mypy(PACKAGE, self.good, self.wrong))

    def test_pyright_says_the_same(self) -> None:
        if importlib.util.find_spec("basedpyright") is None:
            self.skipTest("skipped: the package basedpyright is not installed")
        self.check(pyright(self.folder, PACKAGE, self.good, self.wrong))

    def test_the_stub_has_the_node_types_that_ship(self) -> None:
        program = os.environ["PANOSCOPE_BIN"]
        environment = {**os.environ, "PANOSCOPE_PLUGIN_PATH": str(Path(program).parent / "plugins")}
        stub = subprocess.run([program, "schema", "--python"], capture_output=True, text=True, check=True, env=environment).stdout
        kept = (PACKAGE / "catalogue.pyi").read_text()
        self.assertEqual(stub, kept, "call `panoscope schema --python > core/python/panoscope/catalogue.pyi`")

    def test_names_are_completed(self) -> None:
        self.assertLessEqual(set(ps.__all__), set(dir(ps)))


if __name__ == "__main__":
    unittest.main()
