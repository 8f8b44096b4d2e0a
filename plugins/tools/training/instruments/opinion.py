"""Samples and learning of the second opinion (empty.py): pictures without instruments, and instruments in them. Needs PyTorch."""

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from .augment import lab_statistics, light, photometric
from .data import CLASSES
from .empty import INNER, NONE_BELOW, SOME_FROM, covered
from .outlines import Mixed, Outlined, fit

#: Shares of the samples: empty pictures, empty pictures with instruments set into them; the rest shows instruments where they were.
EMPTY, PEOPLED = 0.45, 0.25
#: How much more the loss of a box with an instrument counts.
KEEPING = 3.0
#: An empty box should be this far below an even chance, in the logit.
MARGIN = 2.5


def empties(paths, width, height):
    """Pictures without instruments, in the form of `outlines`."""
    found = []
    for path in paths:
        picture = cv2.imread(str(path))
        if picture is not None:
            found.append(Outlined(str(path), False, *fit(picture, np.zeros(picture.shape[:2], np.uint8), width, height)))
    return found


class Scenes(Mixed):
    """Endless, seeded pictures with the instruments in them: `ids` as in `Outlined`, and whether all else is known to be empty."""

    def __init__(self, phantom, real, groups, width, height, seed):
        super().__init__(phantom, real, width, height, seed)
        # Every kind of empty pictures counts alike.
        self.groups = [group for group in groups if group]
        # A bag has no shape: where nothing else is familiar, tissue looks like one. It is kept in real and rendered frames alone.
        bag = CLASSES.index("specimen_bag")
        self.donor_weights = self.donor_weights * [f.kinds[number - 1] != bag for f, number in self.donors]
        self.donor_weights /= self.donor_weights.sum()

    def scene(self, number):
        rng = np.random.default_rng((self.seed, number))
        draw = rng.random()
        if draw >= EMPTY + PEOPLED:
            source = self.phantom if self.phantom and rng.random() < 0.35 else self.real
            f = source[int(rng.integers(len(source)))]
            picture, ids, known = f.picture, f.ids, not f.real
            mild = rng.random() < 0.5
        else:
            group = self.groups[int(rng.integers(len(self.groups)))]
            picture, ids, known, mild = group[int(rng.integers(len(group)))].picture, np.zeros((self.height, self.width), np.uint8), True, False
            own, kinds = lab_statistics(picture), []
            for _ in range(int(rng.integers(1, 4)) if draw >= EMPTY else 0):
                picture, ids, kinds = self._paste(picture, ids, kinds, own, rng)
        h, w = ids.shape
        turn, grow = (2.0, (0.97, 1.05)) if mild else (30.0, (0.8, 2.0))
        matrix = cv2.getRotationMatrix2D((w / 2, h / 2), rng.uniform(-turn, turn), np.exp(rng.uniform(*np.log(grow))))
        if rng.random() < 0.5:
            matrix[0] = -matrix[0]
            matrix[0, 2] += w
        border = (0, 0, 0) if rng.random() < 0.5 else (114, 114, 114)
        picture = cv2.warpAffine(picture, matrix, (w, h), borderValue=border)
        ids = cv2.warpAffine(ids, matrix, (w, h), flags=cv2.INTER_NEAREST)
        other = self.real_statistics[int(rng.integers(len(self.real_statistics)))]
        picture = light(picture, rng) if mild else photometric(picture, rng, lab_statistics(picture), other)
        return picture, ids, known


def rows_of(reader, scenes, numbers):
    """Per tap: features, logit of an instrument, and whether there is one, of all boxes that are clearly one or the other."""
    taps = [([], [], []) for _ in reader.taps]
    for number in numbers:
        picture, ids, known = scenes.scene(number)
        for tap, into, (features, logits, boxes) in zip(reader.taps, taps, reader(picture)):
            share = covered(ids, boxes)
            is_some = share >= SOME_FROM
            used = is_some | ((share < NONE_BELOW) & known)
            into[0].append(features[used].astype(np.float16))
            into[1].append(instrument_logit(tap, logits[used]))
            into[2].append(is_some[used])
    return [tuple(np.concatenate(values) for values in tap) for tap in taps]


def instrument_logit(tap, logits):
    """Log odds of any instrument."""
    if not tap.raises:
        return logits[:, tap.column]
    others = np.delete(logits, tap.column, 1)
    most = others.max(1, keepdims=True)
    return (most[:, 0] + np.log(np.exp(others - most).sum(1))) - logits[:, tap.column]


def learn(rows, epochs=60, batch=2048, seed=1):
    """The two layers (weights and biases) of one tap, with the scale of the features folded in."""
    torch.manual_seed(seed)
    features, logits, is_some = (torch.from_numpy(np.asarray(v, np.float32)) for v in rows)
    mean, spread = features.mean(0), features.std(0) + 0.05 * features.std() + 1e-6
    x = (features - mean) / spread
    first, second = nn.Linear(x.shape[1], INNER), nn.Linear(INNER, 1)
    nn.init.constant_(second.bias, -3.0)
    optimiser = torch.optim.AdamW([*first.parameters(), *second.parameters()], lr=3e-3, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    some, none = (is_some > 0.5).nonzero()[:, 0], (is_some < 0.5).nonzero()[:, 0]
    chance = torch.sigmoid(logits)
    count = max(1, min(len(x) // batch, 200))
    for _ in range(epochs):
        for _ in range(count):
            pick = torch.cat([group[torch.randint(len(group), (batch // 2,))] for group in (some, none)])
            doubt = F.softplus(second(F.dropout(F.relu(first(x[pick])), 0.1))[:, 0])
            kept, empty = doubt[: batch // 2], doubt[batch // 2 :]
            keeping = (chance[pick[: batch // 2]] * kept).mean()
            value = KEEPING * keeping + F.softplus(logits[pick[batch // 2 :]] + MARGIN - empty).mean()
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            optimiser.step()
        schedule.step()
    w1 = (first.weight / spread).detach()
    b1 = (first.bias - w1 @ mean).detach()
    return (w1.numpy(), b1.numpy()), (second.weight.detach().numpy(), second.bias.detach().numpy())


def doubt_of(features, weights):
    """What the layers give, in NumPy."""
    (w1, b1), (w2, b2) = weights
    return np.logaddexp(0, np.maximum(features.astype(np.float32) @ w1.T + b1, 0) @ w2[0] + b2)
