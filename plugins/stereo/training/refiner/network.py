"""The refiner: two views and the maps of a matcher in; disparity, scale of its error and occlusion out.

All that is computed from the inputs, the warped right view included, is part of the network, so that the exported file takes them as they are.
Everything runs at half of the views' size and below; the last step doubles the maps.
"""

import torch
from torch import nn
from torch.nn import functional as F

# Values below mean that the matcher knows nothing; the node writes UNKNOWN there.
KNOWN_ABOVE = -5000.0
UNKNOWN = -10000.0
# Rows and columns of the inputs are multiples of this.
GRAIN = 32
# Channels at 1/4, 1/8, 1/16 and 1/32 of the views' size, and blocks there on the way down.
CHANNELS = (32, 48, 64, 96)
BLOCKS = (1, 2, 3, 4)
# Planes at half size that the network sees, besides 16 of the left view and those of each cell.
HALF_PLANES = 6
# Values that a cell's disparity is mixed from: filled, largest and smallest in the cell, largest and smallest of the cells at 1/16 around.
CANDIDATES = 5
# How often known values at 1/32 spread by one cell.
SPREADS = 5
# Columns by which known values are carried along rows, one after the other: 1023 in all.
CARRY_STEPS = tuple(2**step for step in range(10))


class Block(nn.Module):
    """Depthwise, then pointwise, added to what came in."""

    def __init__(self, channels, side=3):
        super().__init__()
        self.depthwise = nn.Conv2d(channels, channels, side, padding=side // 2, groups=channels)
        self.pointwise = nn.Conv2d(channels, channels, 1)

    def forward(self, x):
        return x + self.pointwise(F.relu(self.depthwise(x)))


class Down(nn.Module):
    """Half the size, more channels."""

    def __init__(self, before, after):
        super().__init__()
        self.depthwise = nn.Conv2d(before, before, 4, stride=2, padding=1, groups=before)
        self.pointwise = nn.Conv2d(before, after, 1)

    def forward(self, x):
        return self.pointwise(F.relu(self.depthwise(x)))


def at_columns(plane, columns):
    """Values of `plane` at these columns of the same rows, between its pixels, the nearest ones beyond its sides."""
    last = plane.shape[-1] - 1
    columns = torch.clamp(columns, min=0.0)
    columns = torch.minimum(columns, columns.new_zeros(()) + last)
    low = torch.floor(columns)
    part = columns - low
    low = low.to(torch.int64)
    high = torch.clamp(low + 1, max=last)
    return (1 - part) * torch.gather(plane, 3, low) + part * torch.gather(plane, 3, high)


def nearest_column(plane, columns):
    last = plane.shape[-1] - 1
    index = torch.clamp(torch.floor(columns + 0.5).to(torch.int64), min=0, max=last)
    return torch.gather(plane, 3, index)


def carried(value, known):
    """Values of known pixels, carried to the right over unknown ones, and what is known after that."""
    for step in CARRY_STEPS:
        before, before_known = (F.pad(plane, (step, 0))[:, :, :, :-step] for plane in (value, known))
        value = known * value + (1 - known) * before
        known = torch.maximum(known, before_known)
    return value, known


def filled_rows(value, known, otherwise):
    """Unknown pixels take the smaller of the nearest known values of their row: what is hidden lies behind. Rows that know nothing take `otherwise`."""
    left, is_left = carried(value, known)
    right, is_right = (torch.flip(plane, (3,)) for plane in carried(torch.flip(value, (3,)), torch.flip(known, (3,))))
    far = torch.minimum(left + 100.0 * (1 - is_left), right + 100.0 * (1 - is_right))
    some = torch.maximum(is_left, is_right)
    return some * far + (1 - some) * otherwise


def double(x):
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def between(x):
    """Twice the size: every second pixel as it is, the others between their neighbours."""
    right = torch.cat([x[:, :, :, 1:], x[:, :, :, -1:]], 3)
    below = torch.cat([x[:, :, 1:], x[:, :, -1:]], 2)
    across = torch.cat([right[:, :, 1:], right[:, :, -1:]], 2)
    return F.pixel_shuffle(torch.cat([x, 0.5 * (x + right), 0.5 * (x + below), 0.25 * (x + right + below + across)], 1), 2)


class Refiner(nn.Module):
    """See the module."""

    def __init__(self, channels=CHANNELS, blocks=BLOCKS):
        super().__init__()
        c4, c8, c16, c32 = channels
        self.enter = nn.Conv2d(16 + 4 * HALF_PLANES + CANDIDATES + 2, c4, 1)
        self.levels = nn.ModuleList(
            nn.Sequential(*(Block(width, 3 if level == 0 else 5) for _ in range(count)))
            for level, (width, count) in enumerate(zip(channels, blocks))
        )
        self.downs = nn.ModuleList([Down(c4, c8), Down(c8, c16), Down(c16, c32)])
        self.ups = nn.ModuleList([nn.Conv2d(c32, c16, 1), nn.Conv2d(c16, c8, 1), nn.Conv2d(c8, c4, 1)])
        self.backs = nn.ModuleList([nn.Sequential(Block(c16), Block(c16)), nn.Sequential(Block(c8), Block(c8)), nn.Sequential(Block(c4), Block(c4))])
        # Of each cell of 4x4 px: weights of the candidates (5) and what is added (1); of each of its four pixels at half size: weights of the nine cells around (9), weight of the filled value (1), scale (1), occlusion (1).
        self.guess = nn.Conv2d(c16, 1, 1)
        self.cell = nn.Conv2d(c4, CANDIDATES + 1, 1)
        self.pixels = nn.Conv2d(c4, 4 * 12, 1)
        for head in (self.guess, self.cell):
            nn.init.zeros_(head.weight)
            nn.init.zeros_(head.bias)
        with torch.no_grad():
            self.cell.bias[0] = 3.0
            self.pixels.weight.mul_(0.1)
            self.pixels.bias.zero_()
            self.pixels.bias[16:20] = 2.0

    def forward(self, left, right, disparity, disparity_right):
        """Views as gray 0 to 1, maps in px, all batch x 1 x rows x columns. Gives disparity, scale (of a Laplace error) in px, occlusion 0 to 1."""
        filled, planes, cells, middle, spread = self.prepare(left, right, disparity, disparity_right)
        x = self.enter(torch.cat([F.pixel_unshuffle(left, 4) - 0.4, F.pixel_unshuffle(planes, 2), cells], 1))
        skips = []
        for level, blocks in enumerate(self.levels):
            x = blocks(x)
            if level < 3:
                skips.append(x)
                x = self.downs[level](x)
        guess = None
        for up, back, skip in zip(self.ups, self.backs, reversed(skips)):
            x = back(double(up(x)) + skip)
            if guess is None:
                guess = self.guess(x)
        cell, pixels = self.cell(x), self.pixels(x)
        weights = torch.softmax(cell[:, :CANDIDATES], 1)
        refined = (weights * cells[:, :CANDIDATES]).sum(1, keepdim=True) + 0.3 * (double(double(guess)) + cell[:, CANDIDATES:])
        return self.enlarge(refined, pixels, filled, middle, spread)

    def prepare(self, left, right, disparity, disparity_right):
        """Planes at half size, values of each cell at a quarter, and the middle and spread of the disparities that normalise them."""
        is_known = (disparity > KNOWN_ABOVE).to(left.dtype)
        value = disparity * is_known
        half_known = is_known[:, :, ::2, ::2]
        half = value[:, :, ::2, ::2]
        column = torch.cumsum(torch.ones_like(left[:1, :1, :1, ::2]), 3) * 2 - 2
        back = nearest_column(disparity_right[:, :, ::2, :], column - half)
        apart = torch.clamp(torch.abs(half - back), max=4.0) / 4.0
        # Middle and spread of what both views agree on, of each pair; of all that is known where they agree nowhere.
        both = half_known * ((apart < 0.5).to(left.dtype) + 0.001)
        pixels = both.sum((2, 3), keepdim=True) + 1e-3
        middle = (half * both).sum((2, 3), keepdim=True) / pixels
        spread = (torch.abs(half - middle) * both).sum((2, 3), keepdim=True) / pixels + 2.0
        # The mean of coarser and coarser cells, where they know something.
        norm = (half - middle) / spread * half_known
        norm = torch.clamp(norm, min=-8.0, max=8.0)
        quarter, share = F.avg_pool2d(norm, 2), F.avg_pool2d(half_known, 2)
        sums, shares = [quarter], [share]
        for _ in range(3):
            sums.append(F.avg_pool2d(sums[-1], 2))
            shares.append(F.avg_pool2d(shares[-1], 2))
        total, count = sums[-1], shares[-1]
        for _ in range(SPREADS):
            total, count = (plane + 0.05 * F.avg_pool2d(plane, 3, 1, 1) for plane in (total, count))
        coarse = total / (count + 1e-7)
        for level in (2, 1, 0):
            coarse = (sums[level] + 0.05 * double(coarse)) / (shares[level] + 0.05)
            middle_level = coarse if level == 2 else middle_level
        near = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
        norm = filled_rows(norm, half_known, near)
        filled = middle + spread * norm
        to = column - filled
        shown = at_columns(right[:, :, ::2, :], to)
        inside = (to >= 0).to(left.dtype)
        own = left[:, :, ::2, ::2]
        difference = torch.clamp((own - shown) * 4.0, min=-1.0, max=1.0)
        planes = torch.cat([norm, half_known, apart * half_known, difference * inside, inside, shown - 0.4], 1)
        high = F.max_pool2d(norm - 100.0 * (1 - half_known), 2)
        low = -F.max_pool2d(-norm - 100.0 * (1 - half_known), 2)
        some = (share > 0).to(left.dtype)
        high, low = high * some + coarse * (1 - some), low * some + coarse * (1 - some)
        # Of the surfaces around, those that cells at 1/16 know.
        wide, wide_known = sums[2] / (shares[2] + 1e-3), (shares[2] > 0.1).to(left.dtype)
        wide_high = F.max_pool2d(wide - 100.0 * (1 - wide_known), 3, 1, 1)
        wide_low = -F.max_pool2d(-wide - 100.0 * (1 - wide_known), 3, 1, 1)
        some = (F.max_pool2d(wide_known, 3, 1, 1) > 0).to(left.dtype)
        wide_high, wide_low = (double(double(some * plane + (1 - some) * middle_level)) for plane in (wide_high, wide_low))
        part = torch.clamp(2.0 / spread, max=1.0) + torch.zeros_like(share)
        cells = torch.cat([F.avg_pool2d(norm, 2), high, low, wide_high, wide_low, share, part], 1)
        return filled, planes, cells, middle, spread

    def enlarge(self, refined, pixels, filled, middle, spread):
        """Each pixel at half size is a mean of the nine cells around, and of its own filled value; then twice the size."""
        batch, _, rows, columns = refined.shape
        around = F.pad(refined, (1, 1, 1, 1), mode="replicate")
        total, weights = 0.0, 0.0
        for index in range(9):
            y, x = index // 3, index % 3
            logit = pixels[:, 4 * index : 4 * index + 4]
            weight = torch.exp(torch.clamp(logit, min=-12.0, max=12.0))
            total = total + weight * around[:, :, y : y + rows, x : x + columns]
            weights = weights + weight
        mean = middle + spread * F.pixel_shuffle(total / weights, 2)
        matched = torch.sigmoid(F.pixel_shuffle(pixels[:, 36:40], 2) + 1.0)
        disparity = matched * filled + (1 - matched) * mean
        scale = torch.exp(torch.clamp(F.pixel_shuffle(pixels[:, 40:44], 2) * 2.0, min=-3.0, max=5.0))
        occlusion = torch.sigmoid(F.pixel_shuffle(pixels[:, 44:48], 2) * 2.0 - 2.0)
        return between(disparity), between(scale), between(occlusion)
