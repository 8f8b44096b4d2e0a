"""Learning of the map of tips (tips.py). Needs PyTorch."""

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from .tips import CELL, INPUT

#: Channels of the map, cells of a window that is learned from, windows of a batch.
CHANNELS = 24
WINDOW = (16, 24)
BATCH = 48
#: Share of the windows that show a tip where there is one; peak rate.
AT_TIP = 0.85
RATE = 3e-3


class Map(nn.Module):
    """Score of a tip near each cell (logit), and its distance from the cell's middle in cells."""

    def __init__(self, fine, coarse, channels=CHANNELS):
        super().__init__()
        self.fine, self.coarse = nn.Conv2d(fine, channels, 1), nn.Conv2d(coarse, channels, 1)
        self.wide1, self.wide2, self.wide3 = (nn.Conv2d(channels, channels, 3, padding=k, dilation=k) for k in (1, 2, 3))
        self.out = nn.Conv2d(channels, 3, 1)
        nn.init.constant_(self.out.bias, 0)
        self.out.bias.data[0] = -4

    def forward(self, fine, coarse):
        x = F.relu(self.fine(fine) + F.interpolate(self.coarse(coarse), scale_factor=2, mode="nearest"))
        for layer in (self.wide1, self.wide2, self.wide3):
            x = x + F.relu(layer(x))
        return self.out(x)


def targets(tips):
    """Of tips in px: height of the map (1 at the nearest cell, a bell around it), distances to the tip, and where these count."""
    rows, columns = INPUT[1] // CELL, INPUT[0] // CELL
    y, x = np.mgrid[:rows, :columns]
    heat, off, counts = np.zeros((rows, columns), np.float32), np.zeros((2, rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for tip in tips[np.isfinite(tips[:, 0])]:
        u, v = tip / CELL - 0.5
        square = (x - u) ** 2 + (y - v) ** 2
        bell = np.exp(-square / 2)
        bell[np.unravel_index(np.argmin(square), square.shape)] = 1
        near = (square < 6) & (bell >= heat)
        heat = np.maximum(heat, bell).astype(np.float32)
        off[0][near], off[1][near], counts[near] = (u - x)[near], (v - y)[near], 1
    return heat, off, counts


def loss_of(found, heat, off, counts, known):
    """Focal loss of the map (Law and Deng 2018, CornerNet) and distance of its tips."""
    chance = torch.sigmoid(found[:, 0]).clamp(1e-5, 1 - 1e-5)
    at = (heat >= 1).float() * known
    away = (1 - heat) ** 4 * known * (heat < 1)
    focal = -(at * (1 - chance) ** 2 * chance.log() + away * chance**2 * (1 - chance).log()).sum() / at.sum().clamp(min=1)
    weight = counts * heat
    return focal + (weight * (found[:, 1:] - off).abs().sum(1)).sum() / weight.sum().clamp(min=1)


class Windows:
    """Windows of stored features: `fine` N x C x rows x columns, `coarse` at half of it, `tips` N x 8 x 2 (px), `unsure` N x rows x columns."""

    def __init__(self, fine, coarse, tips, unsure, seed):
        self.values, self.tips, self.unsure = (fine, coarse), tips, unsure
        self.rng = np.random.default_rng(seed)
        self.norm = []
        for values in self.values:
            some = np.asarray(values[:64], np.float32)
            spread = some.std((0, 2, 3))
            self.norm.append((some.mean((0, 2, 3)), spread + 0.05 * spread.mean() + 1e-6))

    def _corner(self, number, most):
        tips = self.tips[number]
        tips = tips[np.isfinite(tips[:, 0])]
        if len(tips) and self.rng.random() < AT_TIP:
            x, y = tips[int(self.rng.integers(len(tips)))] / CELL
            at = (y - self.rng.uniform(2, WINDOW[0] - 2), x - self.rng.uniform(2, WINDOW[1] - 2))
        else:
            at = self.rng.uniform(0, most)
        # Even, because of the features of half the size.
        return np.clip(at, 0, most).astype(int) // 2 * 2

    def batch(self, numbers):
        most = np.array(self.unsure.shape[1:]) - WINDOW
        parts = []
        for number in numbers:
            y, x = self._corner(number, most)
            window, half = np.s_[..., y : y + WINDOW[0], x : x + WINDOW[1]], np.s_[..., y // 2 : (y + WINDOW[0]) // 2, x // 2 : (x + WINDOW[1]) // 2]
            marks = [v[window] for v in (*targets(self.tips[number]), 1 - self.unsure[number].astype(np.float32))]
            parts.append([self.values[0][number][window], self.values[1][number][half], *marks])
        stacked = [np.stack(part).astype(np.float32) for part in zip(*parts)]
        for k, (mean, spread) in enumerate(self.norm):
            stacked[k] = (stacked[k] - mean[:, None, None]) / spread[:, None, None]
        return [torch.from_numpy(part) for part in stacked]


def learn(windows, steps, seed=1, report=None):
    """Weights of a map of tips by name, NumPy, with the scale of the features folded in; the running average of the learned ones."""
    torch.manual_seed(seed)
    model = Map(*(values.shape[1] for values in windows.values))
    optimiser = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=1e-3)
    average = {key: value.clone() for key, value in model.state_dict().items()}
    order = windows.rng.permutation(len(windows.tips))
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = RATE * min(1, step / 50) * (0.5 + 0.5 * np.cos(np.pi * step / steps)) + 2e-5
        numbers = [order[(step * BATCH + k) % len(order)] for k in range(BATCH)]
        fine, coarse, *marks = windows.batch(numbers)
        if windows.rng.random() < 0.8:
            fine = fine + 0.1 * torch.randn_like(fine)
        loss = loss_of(model(fine, coarse), *marks)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 5.0)
        optimiser.step()
        decay = min(0.995, step / (step + 10))
        with torch.no_grad():
            for key, value in model.state_dict().items():
                average[key].mul_(decay).add_(value, alpha=1 - decay)
        if report and step % 100 == 99:
            report(step + 1, loss.item())
    weights = {key: value.numpy().astype(np.float64) for key, value in average.items()}
    for key, (mean, spread) in zip(("fine", "coarse"), windows.norm):
        weights[f"{key}.weight"] /= spread[:, None, None]
        weights[f"{key}.bias"] -= weights[f"{key}.weight"][:, :, 0, 0] @ mean
    return weights
