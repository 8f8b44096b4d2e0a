"""Batches of samples, made while the network learns from those before, and the running average of its weights."""

import queue
import threading

import numpy as np
import torch


def layout(device):
    """How pictures and features lie in memory: depthwise convolutions take half the time on a CPU with channels last, and a third more on a GPU."""
    return torch.channels_last if torch.device(device).type == "cpu" else torch.contiguous_format


def tensors(target):
    """An array, or a dictionary of arrays, as tensors."""
    return {k: torch.from_numpy(v) for k, v in target.items()} if isinstance(target, dict) else torch.from_numpy(target)


class _Made(torch.utils.data.Dataset):
    """Batches by the number of their first sample: pictures B x H x W x 3 in bytes and the truth of each."""

    def __init__(self, samples, batch):
        self.samples, self.batch = samples, batch

    def __getitem__(self, item):
        first, plain = item
        pairs = [self.samples.sample(first + i, plain) for i in range(self.batch)]
        return torch.from_numpy(np.stack([p for p, _ in pairs])), [tensors(t) for _, t in pairs]


def _in_a_thread(made, plan):
    ready = queue.Queue(maxsize=3)

    def make():
        try:
            for item in plan:
                ready.put(made[item])
            ready.put(None)
        except Exception as e:  # told by the thread that waits
            ready.put(e)

    threading.Thread(target=make, daemon=True).start()
    while (item := ready.get()) is not None:
        if isinstance(item, Exception):
            raise item
        yield item


def batches(samples, plan, batch, device="cpu", workers=0):
    """A batch for each item of `plan`, (number of its first sample, whether it is plain), in that order: pictures B x 3 x H x W on
    `device` and the truth of each.

    Made by a second thread, or by `workers` processes, which give the same batches."""
    made = _Made(samples, batch)
    if workers:
        options = {"num_workers": workers, "prefetch_factor": 4, "multiprocessing_context": "fork", "pin_memory": torch.device(device).type != "cpu"}
        found = torch.utils.data.DataLoader(made, batch_size=None, sampler=plan, **options)
    else:
        found = _in_a_thread(made, plan)
    for x, truths in found:
        yield x.to(device, non_blocking=True).permute(0, 3, 1, 2).float().contiguous(memory_format=layout(device)), truths


@torch.no_grad()
def blend(average, model, keep):
    """Moves the running average of weights towards the model's by 1 - `keep`; counters are copied."""
    pairs = list(zip(average.state_dict().values(), model.state_dict().values()))
    held, new = map(list, zip(*(pair for pair in pairs if pair[0].dtype.is_floating_point)))
    # All at once: a call per tensor is what a GPU waits for.
    torch._foreach_lerp_(held, new, 1 - keep)
    for count, other in (pair for pair in pairs if not pair[0].dtype.is_floating_point):
        count.copy_(other)


def store(path, state):
    """Writes a checkpoint beside the old one and puts it in its place: an interruption leaves the old one whole."""
    torch.save(state, path.with_suffix(".new"))
    path.with_suffix(".new").replace(path)
