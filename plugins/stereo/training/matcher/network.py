"""The network: two rectified views and the map of a matcher in; disparity, scale of its error and occlusion out.

One encoder of depthwise convolutions serves both views. Features at 1/8 of the size are compared over all disparities, a small U-Net reads a disparity from
that, features at 1/4 are compared around it, and at half size the right view, warped by what was found, is compared once more. Each step doubles the map by
a learned weighted mean of the nine cells around.

The matcher's map is a hint at each step: a likelihood at 1/8, a value to go to at 1/4, and at full size the value to keep where the network trusts it. It comes with its
holes filled along the rows, and with what the matcher itself knows as a mask. Without a map, unknown everywhere, the network matches alone.
"""

import torch
from torch import nn
from torch.nn import functional as F

# Rows and columns of the views are multiples of this.
GRAIN = 32
# Disparities at 1/8 of the size: the range is 8 times as many px.
CELLS = 27
RANGE_PX = 8.0 * CELLS
# Groups of channels that are compared apart at 1/8.
GROUPS = 4
# Disparities at 1/4 that are compared to either side of the guess.
AROUND = 4
# Mean brightness that each view is brought to, and the smallest and largest gain for that.
BRIGHTNESS, MIN_GAIN, MAX_GAIN = 0.4, 0.6, 6.0
MIN_LOG_SCALE, MAX_LOG_SCALE = -4.0, 5.0
# Scales above lead to the filled map; at twice as much it is taken as it is.
DOUBTFUL_PX = 5.0
# Values of the filled map below mean that the matcher knows nothing of the row; the node writes UNKNOWN there.
KNOWN_ABOVE = -5000.0
UNKNOWN = -10000.0
# Differences of disparity beyond this look alike, in cells.
FAR_CELLS = 4.0


def narrow(before, after):
    return nn.Sequential(nn.Conv2d(before, after, 1), nn.ReLU())


class Block(nn.Module):
    """Depthwise, then pointwise, added to what came in."""

    def __init__(self, channels, side):
        super().__init__()
        self.depthwise = nn.Conv2d(channels, channels, side, padding=side // 2, groups=channels)
        self.pointwise = nn.Conv2d(channels, channels, 1)

    def forward(self, x):
        return F.relu(x + self.pointwise(self.depthwise(x)))


class Down(nn.Module):
    """Half the size, more channels."""

    def __init__(self, before, after):
        super().__init__()
        self.depthwise = nn.Conv2d(before, before, 3, stride=2, padding=1, groups=before)
        self.pointwise = nn.Conv2d(before, after, 1)

    def forward(self, x):
        return F.relu(self.pointwise(self.depthwise(x)))


def blocks(channels, *sides):
    return nn.Sequential(*(Block(channels, side) for side in sides))


def twice(x, mode="nearest"):
    return F.interpolate(x, scale_factor=2.0, mode=mode, **({} if mode == "nearest" else {"align_corners": False}))


def directions(features, strength):
    """Unit vectors along the channels, times a learned strength, with channels last."""
    length = torch.sqrt((features * features).sum(1, keepdim=True) + 1e-3)
    return (features * (1.0 / length)).permute(0, 2, 3, 1) * strength


def correlation(left, right, cells):
    """Products of each left pixel with the right pixels of its row 0 to `cells` - 1 columns to the left: rows x columns x cells, the largest disparity first.

    One product of matrices per row, whose band is read by shifting rows against one another.
    """
    batch, rows, columns, _ = left.shape
    left = F.pad(left, (0, 0, 0, cells))
    right = F.pad(right, (0, 0, cells - 1, 0))
    products = torch.matmul(left, right.transpose(2, 3))
    band = products.reshape(batch, rows, columns + cells - 1, columns + cells)
    return band[:, :, :columns, :cells]


def enlarged(values, logits):
    """Twice the size: each pixel is a weighted mean of the nine cells around its cell."""
    batch, _, rows, columns = values.shape
    around = F.pad(values, (1, 1, 1, 1), mode="replicate")
    around = torch.cat([around[:, :, y : y + rows, x : x + columns] for y in range(3) for x in range(3)], 1)
    weights = torch.exp(torch.clamp(logits, -10.0, 10.0)).reshape(batch, 4, 9, rows, columns)
    return F.pixel_shuffle((weights * around.unsqueeze(1)).sum(2) / weights.sum(2), 2)


def difference(one, other):
    """Of two disparities, limited."""
    return torch.clamp(one - other, -FAR_CELLS, FAR_CELLS)


class Hint:
    """The matcher's map at each size: what is filled, 0 where nothing is, and where the matcher itself knows it."""

    def __init__(self, filled, known):
        self.is_filled1 = (filled > KNOWN_ABOVE).to(filled.dtype)
        self.filled1 = filled * self.is_filled1
        self.filled2, self.known2 = self.filled1[:, :, 1::2, 1::2] / 2.0, known[:, :, 1::2, 1::2]
        self.filled4 = self.filled2[:, :, 1::2, 1::2] / 2.0
        self.is_filled4 = self.is_filled1[:, :, 3::4, 3::4]
        middle_known = self.known2[:, :, 1::2, 1::2]
        # A cell whose middle is unknown has the mean of what it knows.
        share = F.avg_pool2d(self.known2, 2)
        mean = F.avg_pool2d(self.filled2 * self.known2, 2) / (2.0 * share + 1e-6)
        self.map4 = middle_known * self.filled4 + (1 - middle_known) * mean
        self.known4 = (share > 0).to(filled.dtype)

    def likely8(self):
        """Share of the cells at 1/4 within each at 1/8 that have each disparity, and the share that is known."""
        cells = torch.arange(CELLS, dtype=self.map4.dtype).reshape(1, -1, 1, 1)
        near = self.known4 * torch.clamp(1 - torch.abs(self.map4 / 2.0 - cells), min=0.0)
        return F.avg_pool2d(torch.cat([near, self.known4], 1), 2)


class Encoder(nn.Module):
    """Features of a view at 1/4 and 1/8 from those at 1/2, and those to compare."""

    def __init__(self):
        super().__init__()
        self.down4 = nn.Sequential(nn.Conv2d(16, 32, 3, stride=2, padding=1), nn.ReLU())
        self.blocks4 = blocks(32, 3, 3)
        self.down8 = Down(32, 64)
        self.blocks8 = blocks(64, 5, 5, 5)
        self.down16 = Down(64, 96)
        self.blocks16 = blocks(96, 5, 5, 5)
        self.up8 = narrow(96, 64)
        self.merge8 = Block(64, 3)
        self.up4 = narrow(64, 32)
        self.merge4 = Block(32, 3)
        self.compared4 = nn.Conv2d(32, 32, 1)
        self.compared8 = nn.Conv2d(64, 64, 1)

    def forward(self, x):
        x4 = self.blocks4(self.down4(x))
        x8 = self.blocks8(self.down8(x4))
        x16 = self.blocks16(self.down16(x8))
        x8 = self.merge8(x8 + twice(self.up8(x16)))
        x4 = self.merge4(x4 + twice(self.up4(x8)))
        return x4, x8, self.compared4(x4), self.compared8(x8)


class Matcher(nn.Module):
    """See the module."""

    def __init__(self, equal_gain=True):
        super().__init__()
        self.equal_gain = equal_gain
        self.stem = nn.Sequential(nn.Conv2d(3, 16, 3, stride=2, padding=1), nn.ReLU())
        self.shown2 = nn.Conv2d(16, 2, 1)
        self.encoder = Encoder()
        self.enter = narrow(GROUPS * CELLS + 64, 96)
        self.hourglass8 = blocks(96, 5, 5)
        self.hourglass_down = Down(96, 128)
        self.hourglass16 = blocks(128, 5, 5, 5, 5)
        self.hourglass_up = narrow(128, 96)
        self.hourglass_back = blocks(96, 5, 3)
        self.likely = nn.Conv2d(96, CELLS, 1)
        self.enlarge4 = nn.Conv2d(96, 36, 1)
        self.handed4 = narrow(96, 16)
        self.enter4 = narrow(2 * AROUND + 1 + 2 + 16 + 32, 48)
        self.refine4 = blocks(48, 3, 5, 5, 3)
        self.added4 = nn.Conv2d(48, 1, 1)
        self.enlarge2 = nn.Conv2d(48, 36, 1)
        self.handed2 = narrow(48, 8)
        self.enter2 = narrow(2 + 6 + 1 + 8 + 16, 16)
        self.refine2 = blocks(16, 3, 3, 3)
        self.added2 = nn.Conv2d(16, 3, 1)
        # What the hints add; nothing before a training.
        self.hint8 = nn.Conv2d(CELLS + 1, 96, 1)
        self.hint4 = nn.Conv2d(4, 48, 1)
        self.kept4 = nn.Conv2d(48, 1, 1)
        self.hint2 = nn.Conv2d(4, 16, 1)
        self.kept1 = nn.Conv2d(16, 1, 1)
        for one in (self.hint8, self.hint4, self.kept4, self.hint2, self.kept1):
            nn.init.zeros_(one.weight)
            nn.init.zeros_(one.bias)
        self.strength8 = nn.Parameter(torch.tensor(3.0))
        self.strength4 = nn.Parameter(torch.tensor(5.0))

    def forward(self, left, right, filled, known):
        """Views as RGB 0 to 1, batch x 3 x rows x columns; the filled map in px and 1 where the matcher knows it, batch x 1 x rows x columns.

        Gives disparity in px, the logarithm of its scale (of a Laplace error, px) and occlusion 0 to 1.
        """
        outputs = self.steps(left, right, filled, known)
        return outputs[-3], outputs[-2], torch.sigmoid(outputs[-1])

    def steps(self, left, right, filled, known):
        """Likelihood of each disparity at 1/8; disparities at 1/4, 1/4 after refinement and 1/2 in px of the whole size; then what `forward` gives, the occlusion as a logit."""
        both = torch.cat([left, right])
        if self.equal_gain:
            both = both * torch.clamp(BRIGHTNESS / (both.mean((1, 2, 3), keepdim=True) + 1e-3), MIN_GAIN, MAX_GAIN)
        batch = left.shape[0]
        hint = Hint(filled, known)
        x2 = self.stem(both * 4.0 - 2.0)
        x4, x8, compared4, compared8 = self.encoder(x2)
        own2, own4, own8 = x2[:batch], x4[:batch], x8[:batch]
        x, likely = self.read8(compared8, own8, hint)
        index = torch.clamp(torch.argmax(likely, 1, keepdim=True), 1, CELLS - 2)
        index = torch.cat([index - 1, index, index + 1], 1)
        share = torch.gather(torch.softmax(likely, 1), 1, index)
        sure = share.sum(1, keepdim=True)
        guess = (share * index.to(share.dtype)).sum(1, keepdim=True) / (sure + 1e-6)
        guess = enlarged(guess * 2.0, self.enlarge4(x))
        filled4 = hint.is_filled4 * hint.filled4 + (1 - hint.is_filled4) * guess
        found = torch.cat([self.around(compared4, guess), guess * 0.05, twice(sure), twice(self.handed4(x)), own4], 1)
        hints = torch.cat([difference(hint.map4, guess) * hint.known4, hint.known4, difference(filled4, guess), filled4 * 0.05], 1)
        x = self.refine4(F.relu(self.enter4[0](found) + self.hint4(hints)))
        refined = guess + self.added4(x)
        refined = refined + hint.is_filled4 * torch.sigmoid(self.kept4(x) + 2.0) * (filled4 - refined)
        half = enlarged(refined * 2.0, self.enlarge2(x))
        shown = self.shown2(x2)
        found = torch.cat([*self.apart(shown, half), half * 0.02, twice(self.handed2(x)), own2], 1)
        off = self.apart(shown, hint.filled2)[2].abs().sum(1, keepdim=True)
        hints = torch.cat([difference(hint.filled2, half) * hint.known2, hint.known2, off, difference(twice(filled4) * 2.0, half)], 1)
        x = self.refine2(F.relu(self.enter2[0](found) + self.hint2(hints)))
        added = self.added2(x)
        half = half + added[:, :1]
        kept = hint.is_filled1 * torch.sigmoid(twice(self.kept1(x), "bilinear") + 2.0)
        disparity = twice(half * 2.0, "bilinear")
        disparity = disparity + kept * (hint.filled1 - disparity)
        stated = twice(added[:, 1:], "bilinear")
        return likely, guess * 4.0, refined * 4.0, half * 2.0, disparity, torch.clamp(stated[:, :1], MIN_LOG_SCALE, MAX_LOG_SCALE), stated[:, 1:]

    def read8(self, compared, own, hint):
        """What the U-Net at 1/8 makes of the comparison over all disparities, and the likelihood of each."""
        pairs, channels, rows, columns = compared.shape
        grouped = directions(compared.reshape(pairs * GROUPS, channels // GROUPS, rows, columns), self.strength8)
        half = pairs // 2 * GROUPS
        costs = correlation(grouped[:half], grouped[half:], CELLS).permute(0, 3, 1, 2)
        x = self.enter[0](torch.cat([costs.reshape(pairs // 2, GROUPS * CELLS, rows, columns), own], 1))
        x = self.hourglass8(F.relu(x + self.hint8(hint.likely8())))
        deep = self.hourglass16(self.hourglass_down(x))
        x = self.hourglass_back(x + twice(self.hourglass_up(deep)))
        return x, self.likely(x)

    def around(self, compared, guess):
        """The comparison at 1/4 at the disparities around the guess."""
        vectors = directions(compared, self.strength4)
        half = vectors.shape[0] // 2
        cells = 2 * CELLS
        costs = correlation(vectors[:half], vectors[half:], cells)
        low = torch.floor(guess.detach())
        part = guess.detach() - low
        offsets = torch.arange(-AROUND, AROUND + 2, dtype=guess.dtype).reshape(1, -1, 1, 1)
        index = torch.clamp(cells - 1 - (low + offsets), 0, cells - 1).to(torch.int64)
        found = torch.gather(costs, 3, index.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        return found[:, :-1] * (1 - part) + found[:, 1:] * part

    def apart(self, shown, half):
        """Two planes of the left view at half size, and how far those of the right view at the disparity, one less and one more are from them."""
        batch, _, _, columns = half.shape
        own, other = shown[:batch], shown[batch:]
        column = torch.arange(columns, dtype=half.dtype).reshape(1, 1, 1, -1)
        at = torch.clamp(column - half, -2.0, columns + 1.0)
        low = torch.floor(at.detach())
        part = at - low
        values = []
        for step in (-1.0, 0.0, 1.0, 2.0):
            index = torch.clamp(low + step, 0.0, columns - 1.0).to(torch.int64)
            values.append(torch.gather(other, 3, index.expand(-1, 2, -1, -1)))
        return own, *(values[k] * (1 - part) + values[k + 1] * part - own for k in range(3))


def read_weights(network, file):
    """Takes the weights of an ONNX file of the same design, convolution by convolution in the order of its graph."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(str(file)).graph
    known = {one.name: torch.from_numpy(numpy_helper.to_array(one).copy()).float() for one in graph.initializer}
    convolutions = [module for name, module in network.named_modules() if isinstance(module, nn.Conv2d) and not name.startswith(("hint", "kept"))]
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    if len(nodes) != len(convolutions):
        raise ValueError(f"{file} has {len(nodes)} convolutions, the matcher {len(convolutions)}")
    with torch.no_grad():
        for node, module in zip(nodes, convolutions):
            for own, name in ((module.weight, node.input[1]), (module.bias, node.input[2])):
                if own.shape != known[name].shape:
                    raise ValueError(f"{file}: {node.name} is {tuple(known[name].shape)}, the matcher takes {tuple(own.shape)}")
                own.copy_(known[name])
        network.strength8.copy_(known["t8"])
        network.strength4.copy_(known["t4"])


class Exported(nn.Module):
    """The matcher as its file answers: the scale in px, fitted on pairs that the training never saw; the filled map where the scale is large."""

    def __init__(self, matcher, factor=1.0, power=1.0):
        super().__init__()
        self.matcher, self.factor, self.power = matcher, factor, power

    def forward(self, left, right, filled, known):
        disparity, log_scale, occlusion = self.matcher(left, right, filled, known)
        scale = torch.exp(log_scale * self.power) * self.factor
        doubt = torch.clamp((scale - DOUBTFUL_PX) / DOUBTFUL_PX, 0.0, 1.0) * (filled > KNOWN_ABOVE).to(scale.dtype)
        return disparity + doubt * (filled - disparity), scale, occlusion
