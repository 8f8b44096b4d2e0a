"""YOLOX-nano (Ge et al. 2021, arXiv 2107.08430) as a plain PyTorch module: depthwise CSPDarknet, PAFPN, decoupled anchor-free head."""

import torch
from torch import nn

from .onnx_weights import convolutions, narrow_stem

STRIDES = (8, 16, 32)


class Conv(nn.Module):
    """Convolution, batch normalisation, SiLU."""

    def __init__(self, c_in, c_out, kernel=1, stride=1, groups=1):
        super().__init__()
        self.conv = nn.Conv2d(c_in, c_out, kernel, stride, kernel // 2, groups=groups, bias=False)
        self.norm = nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.03)
        self.act = nn.SiLU(inplace=True)

    def forward(self, x):
        return self.act(self.norm(self.conv(x)))


class Separable(nn.Sequential):
    """Depthwise, then pointwise."""

    def __init__(self, c_in, c_out, kernel=3, stride=1):
        super().__init__(Conv(c_in, c_in, kernel, stride, groups=c_in), Conv(c_in, c_out))


class Bottleneck(nn.Module):
    def __init__(self, channels, shortcut):
        super().__init__()
        self.reduce, self.expand, self.shortcut = Conv(channels, channels), Separable(channels, channels), shortcut

    def forward(self, x):
        y = self.expand(self.reduce(x))
        return x + y if self.shortcut else y


class CspLayer(nn.Module):
    """Cross-stage partial layer."""

    def __init__(self, c_in, c_out, count=1, shortcut=True):
        super().__init__()
        half = c_out // 2
        self.main, self.side = Conv(c_in, half), Conv(c_in, half)
        self.blocks = nn.Sequential(*(Bottleneck(half, shortcut) for _ in range(count)))
        self.merge = Conv(2 * half, c_out)

    def forward(self, x):
        main, side = self.main(x), self.side(x)
        return self.merge(torch.cat((self.blocks(main), side), 1))


class SpatialPyramid(nn.Module):
    """Max pooling of 5, 9 and 13 px beside the identity."""

    def __init__(self, c_in, c_out):
        super().__init__()
        self.reduce = Conv(c_in, c_in // 2)
        self.pools = nn.ModuleList(nn.MaxPool2d(k, 1, k // 2) for k in (5, 9, 13))
        self.merge = Conv(c_in * 2, c_out)

    def forward(self, x):
        x = self.reduce(x)
        return self.merge(torch.cat([x] + [pool(x) for pool in self.pools], 1))


class Yolox(nn.Module):
    """Input: B x 3 x H x W, BGR 0..255, H and W multiples of 32. Output of `forward`: per level raw B x (4 + 1 + C) x h x w."""

    def __init__(self, classes, width=16):
        super().__init__()
        w = width
        self.classes = classes
        self.stem = Conv(12, w, 3)
        self.dark2 = nn.Sequential(Separable(w, 2 * w, 3, 2), CspLayer(2 * w, 2 * w, 1))
        self.dark3 = nn.Sequential(Separable(2 * w, 4 * w, 3, 2), CspLayer(4 * w, 4 * w, 3))
        self.dark4 = nn.Sequential(Separable(4 * w, 8 * w, 3, 2), CspLayer(8 * w, 8 * w, 3))
        self.dark5 = nn.Sequential(
            Separable(8 * w, 16 * w, 3, 2), SpatialPyramid(16 * w, 16 * w), CspLayer(16 * w, 16 * w, 1, shortcut=False)
        )
        self.lateral5 = Conv(16 * w, 8 * w)
        self.top_down4 = CspLayer(16 * w, 8 * w, 1, shortcut=False)
        self.lateral4 = Conv(8 * w, 4 * w)
        self.top_down3 = CspLayer(8 * w, 4 * w, 1, shortcut=False)
        self.down3 = Separable(4 * w, 4 * w, 3, 2)
        self.bottom_up4 = CspLayer(8 * w, 8 * w, 1, shortcut=False)
        self.down4 = Separable(8 * w, 8 * w, 3, 2)
        self.bottom_up5 = CspLayer(16 * w, 16 * w, 1, shortcut=False)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        inner = 4 * w
        self.stems = nn.ModuleList(Conv(c, inner) for c in (4 * w, 8 * w, 16 * w))
        tower = lambda: nn.Sequential(Separable(inner, inner), Separable(inner, inner))
        self.class_towers = nn.ModuleList(tower() for _ in STRIDES)
        self.box_towers = nn.ModuleList(tower() for _ in STRIDES)
        self.class_heads = nn.ModuleList(nn.Conv2d(inner, classes, 1) for _ in STRIDES)
        self.box_heads = nn.ModuleList(nn.Conv2d(inner, 4, 1) for _ in STRIDES)
        self.object_heads = nn.ModuleList(nn.Conv2d(inner, 1, 1) for _ in STRIDES)
        for head in (*self.class_heads, *self.object_heads):
            nn.init.constant_(head.bias, -4.6)  # a prior of one in a hundred

    def forward(self, x):
        x = torch.cat((x[..., ::2, ::2], x[..., 1::2, ::2], x[..., ::2, 1::2], x[..., 1::2, 1::2]), 1)
        return self.after_stem(self.stem(x))

    def after_stem(self, x):
        """From the answer of the first convolution to the raw levels."""
        return self.fine_and_levels(x)[1]

    def fine_and_levels(self, x):
        """From the answer of the first convolution to the features of stride 8 and the raw levels."""
        c3 = self.dark3(self.dark2(x))
        return c3, self.neck_and_heads(c3, self.dark4(c3))

    def neck_and_heads(self, c3, c4):
        """From the features of strides 8 and 16 to the raw levels."""
        c5 = self.dark5(c4)
        l5 = self.lateral5(c5)
        t4 = self.top_down4(torch.cat((self.up(l5), c4), 1))
        l4 = self.lateral4(t4)
        p3 = self.top_down3(torch.cat((self.up(l4), c3), 1))
        p4 = self.bottom_up4(torch.cat((self.down3(p3), l4), 1))
        p5 = self.bottom_up5(torch.cat((self.down4(p4), l5), 1))
        levels = []
        for i, p in enumerate((p3, p4, p5)):
            p = self.stems[i](p)
            kind = self.class_heads[i](self.class_towers[i](p))
            near = self.box_towers[i](p)
            levels.append(torch.cat((self.box_heads[i](near), self.object_heads[i](near), kind), 1))
        return levels


def grid_of(sizes):
    """Place (N x 2, in cells) and stride (N) of each row of levels of `sizes` (height, width)."""
    grids, strides = [], []
    for (h, w), stride in zip(sizes, STRIDES):
        y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
        grids.append(torch.stack((x, y), 2).view(-1, 2).float())
        strides.append(torch.full((h * w,), float(stride)))
    return torch.cat(grids), torch.cat(strides)


def flatten(levels):
    """Raw levels -> B x N x (4 + 1 + C), still raw; with the grid (N x 2) and stride (N) of each row."""
    grid, stride = grid_of([level.shape[-2:] for level in levels])
    rows = [level.flatten(2).permute(0, 2, 1) for level in levels]
    return torch.cat(rows, 1), grid.to(levels[0]), stride.to(levels[0])


def decode(raw, grid, stride):
    """Boxes as cx, cy, w, h in input pixels."""
    centre = (raw[..., :2] + grid) * stride[:, None]
    size = raw[..., 2:4].clamp(max=10).exp() * stride[:, None]
    return torch.cat((centre, size), -1)


def load_onnx(model, path):
    """Takes convolution weights from a YOLOX export whose normalisations were folded; heads of another class count stay as they are.

    The export lists convolutions in the order in which they are computed, and so does `model`. Files of export_detector.py are such exports, the
    one that ships included: their wide first convolution is taken apart, weights of 16 bits are widened.
    """
    import onnx

    exported = convolutions(onnx.load(str(path)).graph)
    order = []
    hooks = [m.register_forward_hook(lambda m, *_: order.append(m)) for m in model.modules() if isinstance(m, nn.Conv2d)]
    model.eval()
    with torch.no_grad():
        model(torch.zeros(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    if len(order) != len(exported):
        raise ValueError(f"{path}: {len(exported)} convolutions, expected {len(order)}: not a YOLOX-nano export")
    norms = {m.conv: m.norm for m in model.modules() if isinstance(m, Conv)}
    for at, (module, (name, weight, bias)) in enumerate(zip(order, exported)):
        if at == 0 and weight.shape[1:] == (3, 6, 6):
            weight = narrow_stem(weight)
        weight, bias = torch.from_numpy(weight), torch.from_numpy(bias)
        if weight.shape != module.weight.shape:
            if module in norms or weight.shape[1:] != module.weight.shape[1:]:
                raise ValueError(f"{path}: {name} is {tuple(weight.shape)}, expected {tuple(module.weight.shape)}")
            continue
        module.weight.data.copy_(weight)
        if module in norms:
            norm = norms[module]
            norm.bias.data.copy_(bias)
            norm.weight.data.fill_(1.0)
            norm.running_mean.zero_()
            norm.running_var.fill_(1.0 - norm.eps)
        else:
            module.bias.data.copy_(bias)
    return model
