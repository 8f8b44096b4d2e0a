"""The trained network without what only training needs: normalisation inside the convolutions, one wide first convolution."""

import torch
from torch import nn

from .lite import DEVIATION, MEAN, Unit
from .yolox import Conv


def fold(module):
    """A convolution with its normalisation inside."""
    conv, norm = module.conv, module.norm
    gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    out = nn.Conv2d(conv.in_channels, conv.out_channels, conv.kernel_size, conv.stride, conv.padding, groups=conv.groups)
    out.weight.data = conv.weight.data * gain[:, None, None, None]
    out.bias.data = norm.bias.data - norm.running_mean * gain
    return out


def fold_all(module):
    """Replaces every `Conv` and `Unit` below `module`; gives `module` back."""
    for parent in list(module.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, Conv):
                setattr(parent, name, nn.Sequential(fold(child), child.act))
            elif isinstance(child, Unit):
                padding = [] if child.padded_by_conv else [nn.ZeroPad2d(child.pad)]
                setattr(parent, name, nn.Sequential(*padding, fold(child), child.act))
    return module


def wide_stem(folded):
    """The 3 x 3 convolution over four interleaved pictures as one of 6 x 6 px and stride 2 over the picture itself."""
    w = folded.weight.data
    out = nn.Conv2d(3, w.shape[0], 6, 2, 2)
    wide = torch.zeros(w.shape[0], 3, 6, 6)
    for group, (dy, dx) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        wide[:, :, dy::2, dx::2] = w[:, 3 * group : 3 * group + 3]
    out.weight.data, out.bias.data = wide, folded.bias.data.clone()
    return out


def raw_stem(stem):
    """The first unit of a `lite` backbone, for BGR 0..255: shift, scale and the order of the channels move into the weights.

    The margin becomes the mean instead of zero, which is what zero was after the shift.
    """
    folded = fold(stem)
    weight = folded.weight.data.flip(1) / DEVIATION
    folded.bias.data -= MEAN * weight.sum((1, 2, 3))
    folded.weight.data = weight
    return nn.Sequential(nn.ConstantPad2d(stem.pad, MEAN), folded, stem.act)
