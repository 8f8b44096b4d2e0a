"""The types of the Python package, as mypy sees them: the package itself, and code that uses it. Started by tests/tests/live.rs."""

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


def of_recording(path: Path) -> int:
    return len(ps.Recording(path)["scope.left"].stack())
'''
WRONG = '''
import panoscope as ps

ps.Graph("a.toml").run(frame=20)
ps.log(1)
'''


def mypy(*arguments: str) -> tuple[int, str]:
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", folder, *arguments]
        # The folder of the peers has packages that mypy need not read.
        done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "MYPYPATH": str(PACKAGE.parent)})
    return done.returncode, done.stdout + done.stderr


class Types(unittest.TestCase):
    def test_the_package_is_clean(self) -> None:
        self.assertTrue((PACKAGE / "py.typed").exists())
        code, words = mypy("-p", "panoscope")
        self.assertEqual(code, 0, words)

    def test_code_that_uses_it_is_checked(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            good, wrong = Path(folder) / "good.py", Path(folder) / "wrong.py"
            good.write_text(GOOD)
            wrong.write_text(WRONG)
            code, words = mypy(str(good))
            self.assertEqual(code, 0, words)
            code, words = mypy(str(wrong))
            self.assertEqual((code, words.count("error:")), (1, 2), words)

    def test_names_are_completed(self) -> None:
        self.assertLessEqual(set(ps.__all__), set(dir(ps)))


if __name__ == "__main__":
    unittest.main()
