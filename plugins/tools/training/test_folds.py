"""Folds and their predictions; needs Python alone: python3 -m unittest test_folds"""

import importlib.util
import json
import sys
import tempfile
import unittest
from pathlib import Path

# By its file, as in test_via.py.
spec = importlib.util.spec_from_file_location("folds", Path(__file__).parent / "instruments" / "folds.py")
folds = importlib.util.module_from_spec(spec)
sys.modules["folds"] = folds
spec.loader.exec_module(folds)

GOOD = 'data = "d"\nsplits = ["trainval"]\nframe_rate_hz = 25.0\nblock_s = 10.0\n[folds]\n1 = ["a", "b"]\n2 = ["c"]\n'


class Folds(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / "folds.toml"
        self.path.write_text(GOOD)

    def tearDown(self):
        self.folder.cleanup()

    def test_a_fold_learns_from_all_others(self):
        read = folds.read(self.path)
        self.assertEqual((read.held_out(1), read.trained_on(1)), (("a", "b"), ("c",)))
        self.assertEqual((read.held_out("2"), read.trained_on("2")), (("c",), ("a", "b")))
        with self.assertRaisesRegex(folds.FoldsError, "no fold 3; there are 1, 2"):
            read.held_out(3)

    def test_the_folds_that_ship_hold_each_operation_once(self):
        read = folds.read()
        everything = sorted(o for operations in read.operations.values() for o in operations)
        self.assertEqual(everything, ["v01", "v02", "v03", "v04", "v05", "v06", "v08", "v09", "v10"])
        self.assertEqual([len(o) for o in read.operations.values()], [3, 3, 3])

    def test_errors_name_the_file(self):
        for old, new, message in [
            ('["c"]', '["c", "a"]', "operation a is in fold 1 and in fold 2"),
            ('2 = ["c"]', "", "at least two"),
            ('["c"]', "[]", "fold 2 has no operation"),
            ("splits", "splots", "`splits` is missing"),
            ("[folds]", "[folds", "not TOML"),
        ]:
            self.path.write_text(GOOD.replace(old, new))
            with self.assertRaises(folds.FoldsError) as caught:
                folds.read(self.path)
            for part in (str(self.path), message):
                self.assertIn(part, str(caught.exception))
        self.path.unlink()
        with self.assertRaisesRegex(folds.FoldsError, "no such file of folds"):
            folds.read(self.path)

    def test_operations_without_a_fold_are_refused(self):
        read = folds.read(self.path)
        read.check_operations({"a", "c"})
        with self.assertRaisesRegex(folds.FoldsError, "folds.toml: the operations d, e are in no fold"):
            read.check_operations({"a", "e", "d"})

    def test_predictions_are_as_the_evaluation_reads_them(self):
        frames = {"a_2": [], "a_1": [[1.0, 0.123456, 1.04, 2.06, 30.0, 40.0]]}
        path = folds.write_predictions(self.folder.name, folds.read(self.path), 1, ("grasper", "hook"), {"steps": 3}, frames)
        self.assertEqual(path.name, "fold1.json")
        read = json.loads(path.read_text())
        self.assertEqual(read["frames"], {"a_1": [[1, 0.1235, 1.0, 2.1, 30.0, 40.0]], "a_2": []})
        self.assertEqual((read["fold"], read["held_out"], read["trained_on"]), ("1", ["a", "b"], ["c"]))
        self.assertEqual((read["format"], read["classes"], read["network"]), (folds.FORMAT, ["grasper", "hook"], {"steps": 3}))


if __name__ == "__main__":
    unittest.main()
