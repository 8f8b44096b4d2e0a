"""Graphs that are built in Python: the same as those of a file, and mistakes reported at the calls. Started by tests/tests/python_host.rs."""

import base64
import inspect
import os
import re
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np

import panoscope as ps

COMMAND = os.environ["PANOSCOPE_BIN"]
PLUGIN = '''
import panoscope as ps

@ps.node(family="filter")
class Invert:
    lambda_px: int = ps.param(3, range=(0, 9))

    def process(self, image: ps.Gray8) -> ps.Gray8:
        return 255 - image
'''


GAIN = 2
WEIGHTS = np.ones(3)


def doubled(image):
    return np.minimum(image.astype(np.uint16) * GAIN, 255).astype(np.uint8)


@ps.node(family="filter")
class Brighter:
    """Twice as bright, and shifted."""

    shift: int = ps.param(0, range=(0, 9), doc="Added")

    def process(self, image: ps.Gray8) -> ps.Gray8:
        return doubled(image) // 2 + self.shift


@ps.node()
class NeedsWeights:
    def process(self, image: ps.Gray8) -> ps.Gray8:
        WIDTH = 3  # a name of this function alone
        return (image * WEIGHTS[:WIDTH].sum()).astype(np.uint8)


def line_of(text):
    """Line of this file that has a text for the first time, from 1."""
    lines = Path(__file__).read_text().splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line and "line_of" not in line)


class Building(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="panoscope-building-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name).resolve()
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(self.folder)

    def stereo(self, **options):
        graph = ps.Graph(mode="batch", **options)
        views = graph.phantom(width=160, height=120, seed=3)
        match = graph.stereo_bm(views.left, views.right, search_px=32)
        return graph, views, match

    def test_a_saved_graph_is_the_same_for_file_command_and_editor(self):
        graph, views, match = self.stereo(name="matched")
        smooth = graph.disparity_wls(views.left, match.disparity, lambda_=500, id="smooth")
        judge = graph.evaluate_disparity(disparity=smooth.disparity, truth=views.disparity)
        graph.write_table(judge.table, path="out/judged.csv")
        result = graph.run(frames=3, watch=[smooth.disparity, judge.bad2_pct])
        other = self.folder / "elsewhere"
        other.mkdir()
        for file in (graph.save("matched.toml"), graph.save(other / "matched.toml")):
            read = ps.Graph(file)
            self.assertEqual((read.name, read.outputs, read.get("smooth.lambda")), ("matched", graph.outputs, 500))
            again = read.run(frames=3, watch=["smooth.disparity"])["smooth.disparity"]
            self.assertEqual([p.fingerprint for p in again.packets()], [p.fingerprint for p in result[smooth.disparity].packets()])
            # The table stays where it was: paths start from the file's folder.
            self.assertEqual(Path(read.get("write_table.path")).resolve(), self.folder / "out/judged.csv")
            checked = subprocess.run([COMMAND, "check", file], capture_output=True, text=True)
            self.assertEqual(checked.returncode, 0, checked.stderr)
        self.assertEqual(ps.Graph(self.folder / "matched.toml").text, (self.folder / "matched.toml").read_text())
        run = subprocess.run([COMMAND, "run", "--headless", "--frames", "2", other / "matched.toml"], capture_output=True, text=True)
        self.assertEqual(run.returncode, 0, run.stderr)
        self.assertEqual(len((self.folder / "out/judged.csv").read_text().splitlines()), 3)

    def test_mistakes_are_those_of_a_file_at_the_line_of_the_call(self):
        graph, views, match = self.stereo()
        wrong = {
            "unknown-output": ("lefft, views.right)", "left",
                lambda: graph.stereo_bm(views.lefft, views.right)),
            "unknown-param": ("serch_px=3)", "search_px",
                lambda: graph.stereo_bm(views.left, views.right, serch_px=3)),
            "param-range": ("search_px=3000)", "32 to 512 px",
                lambda: graph.stereo_bm(views.left, views.right, search_px=3000)),
            "param-type": ('search_px="many")', "a whole number",
                lambda: graph.stereo_bm(views.left, views.right, search_px="many")),
            "wrong-packet": ("disparity, views.right)", "gray8 image",
                lambda: graph.stereo_bm(match.disparity, views.right)),
            "missing-input": ("stereo_bm(views.right)", "`stereo_bm` needs `right`",
                lambda: graph.stereo_bm(views.right)),
            "unknown-type": ("stero_bm(views", "stereo_bm",
                lambda: graph.stero_bm(views.left, views.right)),
        }
        before = graph._draft.text()
        for code, (call, words, make) in wrong.items():
            with self.assertRaises(ps.GraphError) as raised:
                make()
            (mistake,) = raised.exception.diagnostics
            self.assertEqual((mistake.code, mistake.file, mistake.line), (code, __file__, line_of(f'"{code}": ') + 1), str(raised.exception))
            self.assertIn(words, str(raised.exception))
            self.assertIn(f"{__file__}:{mistake.line}:{mistake.column}", str(raised.exception))
            shown = Path(__file__).read_text().splitlines()[mistake.line - 1][mistake.column - 1 :]
            self.assertTrue(shown.startswith(call), f"{code}: {shown}")
        self.assertEqual(graph._draft.text(), before, "what was refused is not in the graph")
        # Word for word what the file gets.
        file = self.folder / "wrong.toml"
        file.write_text(before.replace("search_px = 32", "search_px = 3000"))
        with self.assertRaises(ps.GraphError) as of_file:
            ps.check(file)
        with self.assertRaises(ps.GraphError) as of_call:
            graph.stereo_bm(views.left, views.right, search_px=3000)
        said = [(d.code, d.message, d.label, d.help) for d in of_file.exception.diagnostics if d.severity == "error"]
        self.assertEqual([(d.code, d.message, d.label, d.help) for d in of_call.exception.diagnostics], said)

    def test_mistakes_that_only_the_whole_graph_shows_are_told_at_the_call(self):
        graph = ps.Graph()
        views = graph.phantom(id="scope")
        graph.preview(graph.output("no_such_node.image"))
        graph.preview(views.left)
        with self.assertRaises(ps.GraphError) as raised:
            graph.run(frames=1)
        mistake = next(d for d in raised.exception.diagnostics if d.severity == "error")
        self.assertEqual((mistake.code, mistake.line), ("unknown-node", line_of('graph.output("no_such_node')))
        with self.assertRaises(TypeError):
            graph.preview(views.left, views.left, views.left)
        with self.assertRaisesRegex(ps.GraphError, "is a file"):
            ps.Graph("depth.toml").add("preview", "stereo.left")

    def test_names_are_completed(self):
        graph, views, match = self.stereo()
        self.assertLessEqual({"stereo_bm", "capture", "pass_", "run", "save"}, set(dir(graph)))
        self.assertLessEqual({"left", "right", "calibration"}, set(dir(views)))
        self.assertNotIn("stereo_bm", dir(ps.Graph("depth.toml")))
        parameters = inspect.signature(graph.disparity_wls).parameters
        self.assertEqual(list(parameters)[:2], ["image", "disparity"])
        self.assertIn("lambda_", parameters)
        self.assertIn("32 to 512 px; default 128", graph.stereo_bm.__doc__)
        self.assertFalse(hasattr(graph, "no_such_type"))
        own = {name for name in dir(ps.Graph) if not name.startswith("_")}
        self.assertEqual(own & set(graph._draft.names()), set(), "no node type hides behind a method")

    def test_arguments_parts_options_and_own_nodes(self):
        (self.folder / "own.py").write_text(PLUGIN)
        graph = ps.Graph(args={"seed": 5}, mode="batch", plugin_paths=["."])
        views = graph.phantom(width=160, height=120, seed=graph.arg("seed", "whole", default=3, doc="Scene"))
        depth = graph.part("parts/stereo_depth.toml", left=views.left, right=views.right, calibration=views.calibration, search_px=64)
        inverted = graph.add("invert", views.left.aligned("latest", max_age_ms=100), on_fault="stop", lambda_px=np.int64(4))
        result = graph.run(frames=2, watch=[depth.disparity, inverted.image])
        self.assertEqual([len(series) for series in result.values()], [2, 2])
        file = graph.save("all.toml")
        text = file.read_text()
        for words in ('{ arg = "seed" }', 'align = "latest", max_age_ms = 100', 'on_fault = "stop"', "lambda_px = 4"):
            self.assertIn(words, text)
        read = ps.Graph(file, args={"seed": 5}).run(frames=2, watch=["stereo_depth.disparity"])
        fingerprints = [[p.fingerprint for p in series.packets()] for series in (read["stereo_depth.disparity"], result[depth.disparity])]
        self.assertEqual(*fingerprints)

    def test_a_class_of_this_program_is_a_node(self):
        graph = ps.Graph(mode="batch")
        views = graph.phantom(width=160, height=120)
        brighter = graph.add(Brighter, views.left, shift=3)
        result = graph.run(frames=2, watch=[views.left, brighter.image])
        for before, after in zip(result[views.left], result[brighter.image]):
            self.assertEqual(after.shape, before.shape[:2])
            self.assertAlmostEqual(float(after.mean()), float(np.minimum(before.mean(2), 127.5).mean()) + 3, delta=3)
        self.assertIn("Twice as bright", graph._draft.maker("brighter").__doc__)
        # Any program that runs the file finds the class beside it.
        file = graph.save("bright.toml")
        self.assertTrue((self.folder / "brighter_node.py").is_file())
        self.assertNotIn("panoscope-nodes-", file.read_text())
        done = subprocess.run([COMMAND, "run", "--headless", "--frames", "2", file], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        again = ps.Graph(file).run(frames=2, watch=["brighter.image"])["brighter.image"]
        self.assertEqual([p.fingerprint for p in again.packets()], [p.fingerprint for p in result[brighter.image].packets()])
        (self.folder / "brighter_node.py").write_text("# of the user")
        with self.assertRaisesRegex(ps.GraphError, "another folder"):
            graph.save("bright.toml")

    def test_what_a_class_cannot_take_along_is_named(self):
        graph = ps.Graph()
        views = graph.phantom()
        with self.assertRaisesRegex(ps.GraphError, "NeedsWeights uses `WEIGHTS`, a ndarray of the notebook: .* read it from a file"):
            graph.add(NeedsWeights, views.left)
        with self.assertRaisesRegex(ps.GraphError, "Path is not a node type: put `@ps.node"):
            graph.add(Path, views.left)

        @ps.node()
        class Inner:
            def process(self, image: ps.Gray8) -> ps.Gray8:
                return image

        with self.assertRaisesRegex(ps.GraphError, "defined inside a function"):
            graph.add(Inner, views.left)

    def test_sweeps_and_live_changes_take_it(self):
        graph, views, match = self.stereo()
        judge = graph.evaluate_disparity(disparity=match.disparity, truth=views.disparity)
        rows = ps.sweep(graph, {"stereo_bm.search_px": [32, 64]}, judge.bad2_pct, frames=2, progress=False)
        self.assertEqual([row["stereo_bm.search_px"] for row in rows], [32, 64])
        self.assertEqual(set(rows.columns()), set(rows[0]))
        graph.set("stereo_bm.search_px", 64)
        self.assertEqual(graph.get("stereo_bm.search_px"), 64)

    def test_pages_of_notebooks(self):
        graph, views, match = self.stereo()
        points = graph.reproject(views.left, match.disparity, views.calibration)
        page = graph._repr_html_()
        for words in ("phantom.left to stereo_bm.left", "reproject.depth"):
            self.assertIn(words, page)
        # Jupyter shows the elements of an SVG only in notebooks that it trusts, images always.
        self.assertNotIn("<svg", page)
        drawing = base64.b64decode(re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', page)[1]).decode()
        self.assertTrue(drawing.startswith("<svg") and ">stereo_bm</text>" in drawing, drawing)
        result = graph.run(frames=4, watch=[views.left, match.disparity, points.depth, points.cloud, views.detections, views.calibration])
        depth = result[points.depth]
        self.assertEqual(depth.packet(0).packet_type(), "depth")
        known = 100 * np.isfinite(depth[0]).mean()
        self.assertIn(f" mm, {known:.1f} % known", depth.packet(0)._repr_html_())
        self.assertIn(" px, ", result[match.disparity].packet(0)._repr_html_())
        self.assertNotIn("known", result[views.left].packet(0)._repr_html_())
        self.assertEqual(depth._repr_html_().count("<img"), 4)
        self.assertEqual(result._repr_html_().count("<img"), 16)
        self.assertIn("baseline_mm", result[views.calibration].packet(0)._repr_html_())
        self.assertIn("score", result[views.detections][0]._repr_html_())
        self.assertNotIn("application/vnd.jupyter.widget-view+json", depth._repr_mimebundle_(), "no notebook is here")
        self.assertIn("argument", ps.Graph("panorama_files.toml")._repr_html_())

    def test_progress_is_shown_where_it_is_wanted(self):
        text = (
            "import panoscope as ps\n"
            "graph = ps.Graph(mode='live')\n"
            "graph.preview(graph.phantom(width=160, height=120).left)\n"
            "graph.run(frames={frames}, progress={progress})\n"
        )
        for progress, frames, is_shown in ((True, 2000, True), (None, 3, False)):
            source = text.format(frames=frames, progress=progress)
            done = subprocess.run(["python3", "-c", source], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(f"/{frames}" in done.stderr, is_shown, done.stderr)


if __name__ == "__main__":
    unittest.main()
