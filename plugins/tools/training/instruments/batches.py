"""Batches of samples, made by a second thread while the first one learns."""

import queue
import threading

import numpy as np
import torch


def tensors(target):
    """An array, or a dictionary of arrays, as tensors."""
    return {k: torch.from_numpy(v) for k, v in target.items()} if isinstance(target, dict) else torch.from_numpy(target)


def batches(samples, first, count, batch, plain):
    """`count` batches of samples `first ..`: pictures B x 3 x H x W (channels last in memory) and the truth of each."""
    ready = queue.Queue(maxsize=3)

    def make():
        try:
            for b in range(count):
                pairs = [samples.sample(first + b * batch + i, plain) for i in range(batch)]
                x = torch.from_numpy(np.stack([p for p, _ in pairs])).permute(0, 3, 1, 2).float()
                ready.put((x, [tensors(t) for _, t in pairs]))
            ready.put(None)
        except Exception as e:  # told by the thread that waits
            ready.put(e)

    threading.Thread(target=make, daemon=True).start()
    while (item := ready.get()) is not None:
        if isinstance(item, Exception):
            raise item
        yield item


def blend(average, model, keep):
    """Moves the running average of weights towards the model's by 1 - `keep`; counters are copied."""
    with torch.no_grad():
        for held, new in zip(average.state_dict().values(), model.state_dict().values()):
            if held.dtype.is_floating_point:
                held.lerp_(new, 1 - keep)
            else:
                held.copy_(new)


def store(path, state):
    """Writes a checkpoint beside the old one and puts it in its place: an interruption leaves the old one whole."""
    torch.save(state, path.with_suffix(".new"))
    path.with_suffix(".new").replace(path)
