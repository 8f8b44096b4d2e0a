"""The reader of VIA's files; needs Python alone: python3 -m unittest test_via"""

import importlib.util
import json
import tempfile
import unittest
from pathlib import Path

# By its file: the package imports OpenCV.
spec = importlib.util.spec_from_file_location("via", Path(__file__).parent / "instruments" / "via.py")
via = importlib.util.module_from_spec(spec)
spec.loader.exec_module(via)


def region(shape, attributes):
    return {"shape_attributes": shape, "region_attributes": attributes}


REGIONS = [
    region({"name": "polygon", "all_points_x": [1, 3, 3], "all_points_y": [1, 1, 4]}, {"class": "SpecimenBag"}),
    region({"name": "polyline", "all_points_x": [1, 3, 3], "all_points_y": [1, 1, 4]}, {"tool": {"hook": True, "grasper": False}}),
    region({"name": "rect", "x": 4, "y": 2, "width": 5, "height": 3}, {"colour": "red", "label": "hook"}),
    region({"name": "circle", "cx": 10, "cy": 5, "r": 4}, {"class": "hook"}),
    region({"name": "ellipse", "cx": 10, "cy": 5, "rx": 4, "ry": 1, "theta": 1.5707963}, {"class": "hook"}),
    region({"name": "point", "cx": 1, "cy": 1}, {"class": "hook"}),
]


class Via(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / "train.json"

    def tearDown(self):
        self.folder.cleanup()

    def write(self, value):
        self.path.write_text(json.dumps(value))

    def test_both_versions_are_one(self):
        entry = lambda regions: {"f.png12": {"filename": "f.png", "size": 12, "regions": regions, "file_attributes": {}}}
        numbered = {str(k): r for k, r in enumerate(REGIONS)}
        for form in ({"_via_settings": {}, "_via_img_metadata": entry(REGIONS)}, entry(REGIONS), entry(numbered)):
            self.write(form)
            self.assertTrue(via.is_via(self.path))
            [(name, items)] = via.read(self.path)
            self.assertEqual(name, "f.png")
            self.assertEqual([kind for kind, _ in items], ["SpecimenBag", "hook", "hook", "hook", "hook"])
            boxes = [[round(v, 3) for v in via.box(outline)] for _, outline in items]
            self.assertEqual(boxes, [[1, 1, 3, 4], [1, 1, 3, 4], [4, 2, 9, 5], [6, 1, 14, 9], [9, 1, 11, 9]])

    def test_many_regions_keep_their_order(self):
        rect = lambda x: region({"name": "rect", "x": x, "y": 0, "width": 1, "height": 1}, {"class": str(x)})
        self.write({"f": {"filename": "f.png", "regions": {str(k): rect(k) for k in (10, 9, 1, 0)}}})
        self.assertEqual([kind for kind, _ in via.read(self.path)[0][1]], ["0", "1", "9", "10"])

    def test_errors_name_file_picture_and_region(self):
        good = REGIONS[2]
        for wrong, words in [
            (region({"name": "star"}, {"class": "hook"}), "`star` is not known"),
            (region({"name": "rect", "x": 1, "y": 1, "width": -1, "height": 2}, {"class": "hook"}), "`width` of its rect is -1"),
            (region({"name": "polygon", "all_points_x": [1], "all_points_y": [1]}, {"class": "hook"}), "at least three"),
            (region(good["shape_attributes"], {}), "no `region_attributes`"),
            (region(good["shape_attributes"], {"a": "x", "b": "y"}), "none is called class"),
            (region(good["shape_attributes"], {"class": {"hook": True, "clipper": True}}), "2 are ticked"),
        ]:
            self.write({"f": {"filename": "f.png", "regions": [good, wrong]}})
            with self.assertRaises(via.ViaError) as caught:
                via.read(self.path)
            for part in (str(self.path), "`f.png`", "region 2", words):
                self.assertIn(part, str(caught.exception))

    def test_other_files_are_none(self):
        for other in ({"images": [], "annotations": [], "categories": []}, [], {}):
            self.write(other)
            self.assertFalse(via.is_via(self.path))
        self.path.write_text("no JSON")
        self.assertFalse(via.is_via(self.path))


if __name__ == "__main__":
    unittest.main()
