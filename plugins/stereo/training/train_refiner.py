#!/usr/bin/env python3
"""Trains the refiner `stereo_net` on pairs of `make_pairs.py`. Goes on from OUT/state.pt where there is one."""

import argparse
import json
import math
import os
import signal
import time
from pathlib import Path


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="folders of make_pairs.py")
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint and the scores")
    parser.add_argument("--minutes", type=float, default=60, help="time to train, of all starts together; the rate falls to nothing at its end")
    parser.add_argument("--batch", type=int, default=2, help="pairs per step")
    parser.add_argument("--rows", type=int, default=224, help="rows of a sample, a multiple of 32; columns are whole")
    parser.add_argument("--rate", type=float, default=2e-3, help="learning rate at the start")
    parser.add_argument("--threads", type=int, default=2, help="threads of PyTorch")
    parser.add_argument("--save-minutes", type=float, default=3, help="time between checkpoints")
    parser.add_argument("--max-steps", type=int, default=0, help="ends after so many steps; 0 does not")
    parser.add_argument("--seed", type=int, default=1, help="of the weights and samples")
    return parser.parse_args()


def loss_of(out, truth, visible, lit, near, known):
    """The error, bounded where it is large, more at edges; the scale of the error; the occlusion. Pairs of which a matcher knows little count less."""
    import torch
    from torch.nn import functional as F

    disparity, scale, occlusion = out
    error = torch.abs(disparity - truth)
    weight = (0.1 + 0.9 * lit) * (1 + 1.5 * near) * known.mean((2, 3), keepdim=True).clamp(min=0.1)
    weight = weight / weight.mean()
    fit = (weight * (error / (1 + error) + 0.1 * torch.clamp(error, max=20))).mean()
    stated = ((0.3 + 0.7 * lit) * (error.detach() / scale + torch.log(scale))).mean()
    hidden = F.binary_cross_entropy(torch.clamp(occlusion, 1e-4, 1 - 1e-4), 1 - visible)
    return fit + 0.2 * stated + 0.2 * hidden, fit


def score(network, data, matcher):
    """Errors on the pairs kept: of the lit pixels that both views show, and of those near edges; share of errors within twice the scale."""
    import torch

    from refiner.pairs import kept

    sums = torch.zeros(6)
    with torch.no_grad():
        for inputs, truth, visible, lit, near in kept(data, matcher):
            disparity, scale, _ = network(*inputs)
            error, counts = torch.abs(disparity - truth), (lit * visible) > 0
            known = inputs[2][counts] > -5000
            matched = torch.abs(inputs[2] - truth)[counts][known]
            found = error[counts]
            sums += torch.tensor([found.mean(), (found > 2).float().mean(), error[counts & (near > 0)].mean().nan_to_num(), found[known].mean(), matched.mean(), (found < 3 * scale[counts]).float().mean()])
    names = ("mean_px", "bad2", "edge_px", "mean_where_matched_px", "matcher_px", "within_3_scales")
    return dict(zip(names, (sums / max(1, sum(1 for _ in kept(data, matcher)))).tolist()))


def main():
    options = arguments()
    import cv2
    import torch

    from refiner.network import KNOWN_ABOVE, Refiner
    from refiner.pairs import MATCHERS, Batches

    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    network, average = Refiner(), Refiner()
    average.load_state_dict(network.state_dict())
    optimizer = torch.optim.AdamW(network.parameters(), lr=options.rate, weight_decay=1e-4)
    state_file = options.out / "state.pt"
    step, spent = 0, 0.0
    if state_file.exists():
        state = torch.load(state_file, weights_only=True)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        step, spent = state["step"], state["minutes"]
    print(f"{sum(p.numel() for p in network.parameters())} parameters, step {step}, {spent:.1f} min so far", flush=True)
    batches = Batches(options.data, options.batch, options.rows, options.seed + step)
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))

    def save(minutes):
        state = {"network": network.state_dict(), "average": average.state_dict(), "optimizer": optimizer.state_dict(), "step": step, "minutes": minutes}
        torch.save(state, state_file.with_suffix(".new"))
        os.replace(state_file.with_suffix(".new"), state_file)

    start, saved, recent = time.monotonic(), time.monotonic(), []
    minutes = spent
    while minutes < options.minutes and not stopped and not (options.max_steps and step >= options.max_steps):
        rate = options.rate * max(0.5 * (1 + math.cos(math.pi * min(minutes / options.minutes, 1))), 0.005) * min(1, (step + 1) / 200)
        for group in optimizer.param_groups:
            group["lr"] = rate
        inputs, *rest = next(batches)
        loss, fit = loss_of(network(*inputs), *rest, (inputs[2] > KNOWN_ABOVE).float())
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        step += 1
        keep = min(0.998, 1 - 8 / (step + 8))
        with torch.no_grad():
            for mean, now in zip(average.parameters(), network.parameters()):
                mean.lerp_(now, 1 - keep)
        recent.append(float(fit.detach()))
        minutes = spent + (time.monotonic() - start) / 60
        if step % 100 == 0:
            print(f"step {step}, {minutes:.1f} min, rate {rate:.5f}, loss {sum(recent) / len(recent):.4f}", flush=True)
            recent.clear()
        if time.monotonic() - saved > 60 * options.save_minutes:
            save(minutes)
            saved = time.monotonic()
    save(minutes)
    scores = {matcher: score(average, options.data[0], matcher) for matcher in MATCHERS}
    (options.out / "scores.json").write_text(json.dumps({"step": step, "minutes": round(minutes, 1), "scores": scores}, indent=1))
    print(json.dumps(scores))


if __name__ == "__main__":
    main()
