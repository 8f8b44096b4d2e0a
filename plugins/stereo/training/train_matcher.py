#!/usr/bin/env python3
"""Trains the matcher `stereo_net` on pairs of `make_pairs.py`. Goes on from OUT/state.pt where there is one."""

import argparse
import json
import math
import os
import signal
import time
from pathlib import Path

import cv2
import torch
from torch.nn import functional as F

from matcher.network import CELLS, Matcher, read_weights
from matcher.pairs import MATCHERS, Batches, kept

# Errors above are as bad as this, px.
WORST_PX = 20.0


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="folders of make_pairs.py, which may still grow")
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint and the scores")
    parser.add_argument("--start", type=Path, help="ONNX file of the same design, or state.pt, whose weights a first start takes")
    parser.add_argument("--minutes", type=float, default=60, help="time to train, of all starts together; the rate falls to nothing at its end")
    parser.add_argument("--batch", type=int, default=2, help="pairs per step")
    parser.add_argument("--rows", type=int, default=192, help="rows of a sample, a multiple of 32; columns are whole")
    parser.add_argument("--keep-views", action="store_true", help="leaves what the network sees in each view by itself as it is: a third less time per step")
    parser.add_argument("--rate", type=float, default=4e-4, help="largest learning rate")
    parser.add_argument("--threads", type=int, default=2, help="threads of PyTorch")
    parser.add_argument("--save-minutes", type=float, default=2, help="time between checkpoints")
    parser.add_argument("--max-steps", type=int, default=0, help="ends after so many steps; 0 does not")
    parser.add_argument("--seed", type=int, default=1, help="of the weights and samples")
    return parser.parse_args()


def far_off(found, truth):
    """The error, bounded where it is large."""
    error = torch.abs(found - truth)
    return error / (1 + error) + 0.1 * torch.clamp(error, max=WORST_PX)


def at(plane, step):
    """Every `step`-th pixel, of the middle of its cell."""
    return plane[:, :, step // 2 :: step, step // 2 :: step]


def unlikely(logits, truth, weight):
    """Cross entropy to the two cells at 1/8 beside the truth."""
    cell = torch.clamp(at(truth, 8) / 8.0, 0, CELLS - 1.001)
    low = torch.floor(cell)
    part, low = cell - low, low.to(torch.int64)
    logs = torch.log_softmax(logits, 1)
    found = (1 - part) * torch.gather(logs, 1, low) + part * torch.gather(logs, 1, low + 1)
    return -(found * weight).mean()


def loss_of(steps, truth, visible, lit, near):
    """Errors of all steps, more at edges, less where a view is black or the other does not show the point; the scale; the occlusion."""
    likely, guess4, refined4, half, disparity, log_scale, hidden = steps
    shown = (0.12 + 0.88 * lit) * (0.7 + 0.3 * visible)
    weight = shown * (1 + 1.5 * near)
    weight = weight / weight.mean()
    fit = (far_off(disparity, truth) * weight).mean()
    early = sum(share * (far_off(one, at(truth, step)) * at(weight, step)).mean() for share, one, step in ((0.2, guess4, 4), (0.3, refined4, 4), (0.3, half, 2)))
    error = torch.clamp(torch.abs(disparity.detach() - truth), max=100.0)
    stated = ((0.3 + 0.7 * lit) * (error * torch.exp(-log_scale) + log_scale)).mean()
    occlusion = F.binary_cross_entropy_with_logits(hidden, 1 - visible)
    return fit + early + 0.2 * unlikely(likely, truth, at(weight, 8)) + 0.2 * stated + 0.2 * occlusion, fit


def score(network, folder, matcher):
    """Errors on the pairs kept, of lit pixels: of those that both views show, of all, near edges; the share within three scales."""
    sums, count = torch.zeros(6), 0
    with torch.no_grad():
        for inputs, truth, visible, lit, near in kept(folder, matcher):
            disparity, log_scale, _ = network(*inputs)
            error, seen = torch.abs(disparity - truth), (lit * visible) > 0
            found = error[seen]
            sums += torch.stack([
                found.mean(),
                (found > 2).float().mean(),
                error[lit > 0].mean(),
                error[seen & (near > 0)].mean().nan_to_num(),
                (found < 3 * torch.exp(log_scale[seen])).float().mean(),
                error[lit == 0].mean().nan_to_num(),
            ])
            count += 1
    names = ("mean_px", "bad2", "mean_with_hidden_px", "edge_px", "within_3_scales", "black_px")
    return dict(zip(names, (sums / max(count, 1)).tolist()))


def rate_at(minutes, step, options):
    """Rises for 100 steps, then falls as a cosine."""
    return options.rate * max(0.5 * (1 + math.cos(math.pi * min(minutes / options.minutes, 1))), 0.005) * min(1, (step + 1) / 100)


def main():
    options = arguments()
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    network, average = (Matcher().to(memory_format=torch.channels_last) for _ in range(2))
    if options.start and options.start.suffix == ".pt":
        # Of a run without hints, too.
        network.load_state_dict(torch.load(options.start, weights_only=True)["average"], strict=False)
    elif options.start:
        read_weights(network, options.start)
    average.load_state_dict(network.state_dict())
    if options.keep_views:
        for part in (network.stem, network.encoder):
            part.requires_grad_(False)
    hints = [one for name, one in network.named_parameters() if name.startswith(("hint", "kept"))]
    others = [one for name, one in network.named_parameters() if not name.startswith(("hint", "kept"))]
    # What starts at nothing learns faster.
    optimizer = torch.optim.AdamW([{"params": others, "share": 1.0}, {"params": hints, "share": 4.0}], lr=options.rate, weight_decay=1e-4)
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
        for group in optimizer.param_groups:
            group["lr"] = group["share"] * rate_at(minutes, step, options)
        inputs, *truth = next(batches)
        loss, fit = loss_of(network.steps(*inputs), *truth)
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
            print(f"step {step}, {minutes:.1f} min, rate {rate_at(minutes, step, options):.5f}, loss {sum(recent) / len(recent):.4f}", flush=True)
            recent.clear()
        if time.monotonic() - saved > 60 * options.save_minutes:
            save(minutes)
            batches.renew()
            saved = time.monotonic()
    save(minutes)
    scores = {matcher or "none": score(average, options.data[0], matcher) for matcher in (*MATCHERS, "")}
    (options.out / "scores.json").write_text(json.dumps({"step": step, "minutes": round(minutes, 1), "scores": scores}, indent=1))
    print(json.dumps(scores))


if __name__ == "__main__":
    main()
