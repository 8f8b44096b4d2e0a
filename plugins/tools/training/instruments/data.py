"""Frames with boxes, read from VOC XML, COCO or VIA JSON or YOLO text, kept decoded and shrunk in memory."""

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from . import via

CLASSES = ("grasper", "bipolar", "hook", "scissors", "clipper", "irrigator", "specimen_bag")


def normal_name(name):
    """`SpecimenBag`, `Specimen Bag` and `specimen_bag` are one class."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|[\s-]+", "_", name.strip()).lower()


@dataclass
class Frame:
    """One picture: `boxes` is K x 5, class, x0, y0, x1, y1 in pixels of the stored picture."""

    name: str
    group: str
    path: Path
    size: tuple  # width, height as stored
    boxes: np.ndarray
    picture: np.ndarray = None
    scale: np.ndarray = None  # x, y, x, y: pixels of `picture` per pixel as stored

    def load(self, width):
        """Decodes, shrinks to at most `width` pixels and scales the boxes with it."""
        picture = cv2.imread(str(self.path))
        if picture is None:
            raise ValueError(f"{self.path}: not a picture that can be read")
        h, w = picture.shape[:2]
        width = min(width, w)
        height = round(h * width / w)
        self.picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        self.scale = np.array([width / w, height / h] * 2, np.float32)
        self.boxes = self.boxes * np.concatenate(([1], self.scale)).astype(np.float32)
        return self


def group_of(name):
    """The operation a frame comes from: what stands before the last underscore (`v02_001250` -> `v02`)."""
    return name.rsplit("_", 1)[0]


def _rows(rows):
    return np.array(rows, np.float32).reshape(-1, 5)


def read_voc(folder, split, classes):
    folder = Path(folder)
    names = (folder / "ImageSets" / f"{split}.txt").read_text().split()
    frames = []
    for name in names:
        annotation, picture = folder / "Annotations" / f"{name}.xml", folder / "JPEGImages" / f"{name}.jpg"
        if not (annotation.exists() and picture.exists()):
            continue
        root = ElementTree.parse(annotation).getroot()
        rows = []
        for item in root.iter("object"):
            kind = normal_name(item.findtext("name"))
            if kind not in classes:
                raise ValueError(f"{annotation}: class `{kind}` is not one of {', '.join(classes)}")
            box = item.find("bndbox")
            rows.append([classes.index(kind)] + [float(box.findtext(k)) for k in ("xmin", "ymin", "xmax", "ymax")])
        size = (int(root.findtext("size/width")), int(root.findtext("size/height")))
        frames.append(Frame(name, group_of(name), picture, size, _rows(rows)))
    return frames


def read_coco(folder, split, classes):
    folder = Path(folder)
    truth = json.loads((folder / f"{split}.json").read_text())
    names = {c["id"]: normal_name(c["name"]) for c in truth["categories"]}
    rows = {}
    for a in truth["annotations"]:
        x, y, w, h = a["bbox"]
        rows.setdefault(a["image_id"], []).append([classes.index(names[a["category_id"]]), x, y, x + w, y + h])
    return [
        Frame(Path(i["file_name"]).stem, group_of(Path(i["file_name"]).stem), folder / i["file_name"], (i["width"], i["height"]), _rows(rows.get(i["id"], [])))
        for i in truth["images"]
    ]


def via_picture(folder, name):
    """The picture that a file of VIA names, in `folder` or in `images` in it."""
    found = [p for p in (Path(folder) / name, Path(folder) / "images" / name) if p.is_file()]
    if not found:
        raise FileNotFoundError(f"{folder}: the picture `{name}` of a VIA file is not there")
    return found[0]


def read_via(folder, split, classes):
    folder = Path(folder)
    path = folder / f"{split}.json"
    frames = []
    for name, regions in via.read(path):
        picture = via_picture(folder, name)
        rows = []
        for number, (kind, outline) in enumerate(regions, 1):
            kind = normal_name(kind)
            if kind not in classes:
                raise ValueError(f"{path}: picture `{name}`, region {number}: class `{kind}` is not one of {', '.join(classes)}")
            rows.append([classes.index(kind), *via.box(outline)])
        h, w = cv2.imread(str(picture)).shape[:2]
        frames.append(Frame(picture.stem, group_of(picture.stem), picture, (w, h), _rows(rows)))
    return frames


def read_yolo(folder, split, _classes):
    folder = Path(folder)
    frames = []
    for picture in sorted((folder / "images" / split).glob("*.jpg")) + sorted((folder / "images" / split).glob("*.png")):
        h, w = cv2.imread(str(picture)).shape[:2]
        label = folder / "labels" / split / f"{picture.stem}.txt"
        rows = []
        for line in label.read_text().splitlines() if label.exists() else []:
            k, cx, cy, bw, bh = map(float, line.split()[:5])
            rows.append([k, (cx - bw / 2) * w, (cy - bh / 2) * h, (cx + bw / 2) * w, (cy + bh / 2) * h])
        frames.append(Frame(picture.stem, group_of(picture.stem), picture, (w, h), _rows(rows)))
    return frames


def read(folder, split, classes=CLASSES):
    """Reads whichever of the layouts `folder` holds."""
    folder = Path(folder)
    if (folder / "ImageSets" / f"{split}.txt").exists():
        return read_voc(folder, split, classes)
    if via.is_via(folder / f"{split}.json"):
        return read_via(folder, split, classes)
    if (folder / f"{split}.json").exists():
        return read_coco(folder, split, classes)
    if (folder / "images" / split).is_dir():
        return read_yolo(folder, split, classes)
    raise FileNotFoundError(
        f"{folder}: no ImageSets/{split}.txt (VOC), no {split}.json (COCO, VIA) and no images/{split}/ (YOLO) in it"
    )


def letterbox(picture, boxes, width, height):
    """Fits a picture into width x height, centred at the top left, 114 elsewhere. Returns picture, boxes, scale."""
    h, w = picture.shape[:2]
    scale = min(width / w, height / h)
    size = (round(w * scale), round(h * scale))
    out = np.full((height, width, 3), 114, np.uint8)
    out[: size[1], : size[0]] = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR if scale > 0.5 else cv2.INTER_AREA)
    return out, boxes * np.array([1, scale, scale, scale, scale], np.float32), scale
