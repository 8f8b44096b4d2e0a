"""What a long training needs beside the network: a schedule, checkpoints, a pause while others measure."""

import math
import signal
import time
from pathlib import Path

import torch

from .batches import store


class Schedule:
    """How far a training is, 0..1, by steps or by minutes, and the learning rate there: short warm-up, then a cosine down to 2 %."""

    WARM_UP_STEPS = 200

    def __init__(self, steps, minutes=None):
        self.steps, self.minutes = steps, minutes

    def progress(self, step, trained_s):
        return min(1.0, trained_s / (60 * self.minutes) if self.minutes else step / self.steps)

    def factor(self, step, progress):
        return min(1.0, (step + 1) / self.WARM_UP_STEPS) * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * progress)))


class Pause:
    """Waits between batches while a file exists."""

    def __init__(self, path, poll_s=5.0):
        self.path, self.poll_s = path, poll_s

    def wait(self):
        """Seconds waited."""
        if not (self.path and self.path.exists()):
            return 0.0
        print(f"paused while {self.path} exists", flush=True)
        begun = time.monotonic()
        while self.path.exists():
            time.sleep(self.poll_s)
        waited = time.monotonic() - begun
        print(f"goes on after {waited:.0f} s", flush=True)
        return waited


class Stop:
    """Turns SIGTERM and SIGINT into a request that the loop answers with a checkpoint."""

    def __init__(self):
        self.requested = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._request)

    def _request(self, *_):
        self.requested = True


class Checkpoint:
    """`state.pt` of a folder: what training goes on from, with the settings that it must go on with."""

    def __init__(self, folder, settings):
        self.path, self.settings = Path(folder) / "state.pt", settings

    def read(self, resume):
        """The stored state, or None for a new training. Raises where the folder and `resume` do not fit together."""
        if not self.path.exists():
            return None
        if not resume:
            raise SystemExit(f"{self.path}: a training lies there; --resume goes on with it, another --out begins anew")
        state = torch.load(self.path, map_location="cpu", weights_only=True)
        other = {k: (v, state["settings"].get(k)) for k, v in self.settings.items() if state["settings"].get(k) != v}
        if other:
            changes = ", ".join(f"{k} was {old}, is {new}" for k, (new, old) in other.items())
            raise SystemExit(f"{self.path}: it was begun with other settings ({changes}); give the same ones, or another --out")
        return state

    def write(self, **state):
        store(self.path, {"settings": self.settings, **state})


def parameter_groups(model, rate, backbone_rate, decay=5e-4):
    """Groups for the optimiser: weights decay, biases and normalisation do not; those of a pretrained backbone learn at `backbone_rate` x `rate`."""
    groups = {}
    for name, p in model.named_parameters():
        key = (name.startswith("backbone."), p.ndim > 1)
        groups.setdefault(key, []).append(p)
    return [
        {"params": found, "weight_decay": decay if decays else 0.0, "peak": rate * (backbone_rate if pretrained else 1.0)}
        for (pretrained, decays), found in groups.items()
    ]
