"""Annotations of the VGG Image Annotator (VIA), projects and exports of versions 1 and 2: outlines with class names."""

import json
import math
from pathlib import Path

PROJECT = "_via_img_metadata"
CLASS = ("class", "label", "name", "type", "tool", "instrument")
ROUND = 96


class ViaError(ValueError):
    """What is wrong, with file, picture and region (counted from 1)."""


def pictures(value):
    """The pictures of a parsed file, or None where it is not a file of VIA."""
    if not isinstance(value, dict):
        return None
    if PROJECT in value:
        return value[PROJECT]
    is_picture = lambda entry: isinstance(entry, dict) and "filename" in entry and "regions" in entry
    return value if value and all(map(is_picture, value.values())) else None


def is_via(path):
    """Whether a file is one of VIA."""
    path = Path(path)
    try:
        return path.is_file() and pictures(json.loads(path.read_text())) is not None
    except ValueError:
        return False


def _class_of(region, at):
    attributes = region.get("region_attributes") or {}
    if not attributes:
        raise ViaError(f"{at}: it has no `region_attributes`: name its class")
    if len(attributes) == 1:
        key = next(iter(attributes))
    else:
        key = next((k for name in CLASS for k in attributes if k.lower() == name), None)
        if key is None:
            raise ViaError(f"{at}: of its attributes {', '.join(attributes)} none is called {', '.join(CLASS)}")
    value = attributes[key]
    if isinstance(value, dict):
        ticked = [name for name, on in value.items() if on is True]
        if len(ticked) != 1:
            raise ViaError(f"{at}: of the boxes of `{key}` {len(ticked)} are ticked, one is needed")
        value = ticked[0]
    name = str(value).strip()
    if not name or name == "undefined":
        raise ViaError(f"{at}: `{key}` is empty: name its class")
    return name


def _outline(region, at):
    """Corners of a region, px; None for a point."""
    shape = region.get("shape_attributes") or {}
    kind = shape.get("name")

    def number(name, least=None):
        value = shape.get(name)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ViaError(f"{at}: its {kind} has no number `{name}`")
        if least is not None and value <= least:
            raise ViaError(f"{at}: `{name}` of its {kind} is {value}: it has to be above {least}")
        return float(value)

    def round_(rx, ry, turn):
        cx, cy, s, c = number("cx"), number("cy"), math.sin(turn), math.cos(turn)
        angles = [2 * math.pi * k / ROUND for k in range(ROUND)]
        return [
            (cx + rx * math.cos(a) * c - ry * math.sin(a) * s, cy + rx * math.cos(a) * s + ry * math.sin(a) * c) for a in angles
        ]

    if kind in ("polygon", "polyline"):
        xs, ys = shape.get("all_points_x") or [], shape.get("all_points_y") or []
        if len(xs) != len(ys) or len(xs) < 3:
            raise ViaError(f"{at}: its {kind} has {len(xs)} x and {len(ys)} y: at least three of both are needed")
        return [(float(x), float(y)) for x, y in zip(xs, ys)]
    if kind == "rect":
        x, y, w, h = number("x"), number("y"), number("width", 0), number("height", 0)
        return [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    if kind == "circle":
        return round_(number("r", 0), number("r", 0), 0.0)
    if kind == "ellipse":
        return round_(number("rx", 0), number("ry", 0), float(shape.get("theta") or 0.0))
    if kind == "point":
        return None
    raise ViaError(f"{at}: a shape `{kind}` is not known: polygon, polyline, rect, circle and ellipse are")


def read(path):
    """Per picture its file name and its regions, each a class name as written and a list of corners in px."""
    path = Path(path)
    found = pictures(json.loads(path.read_text()))
    if found is None:
        raise ViaError(f"{path}: not a file of VIA")
    out = []
    for key, entry in found.items():
        name = entry.get("filename")
        if not isinstance(name, str):
            raise ViaError(f"{path}: the entry `{key}` has no `filename`")
        regions = entry.get("regions") or []
        if isinstance(regions, dict):
            # Numbers as text: "10" comes after "9".
            regions = [regions[k] for k in sorted(regions, key=lambda k: (0, int(k)) if k.isdigit() else (1, 0))]
        items = []
        for number, region in enumerate(regions, 1):
            at = f"{path}: picture `{name}`, region {number}"
            outline = _outline(region, at)
            if outline is not None:
                items.append((_class_of(region, at), outline))
        out.append((name, items))
    return out


def box(outline):
    """x0, y0, x1, y1 of an outline."""
    xs, ys = [x for x, _ in outline], [y for _, y in outline]
    return min(xs), min(ys), max(xs), max(ys)
