#!/usr/bin/env python3
"""Fits what `export_matcher.py --scale` takes on the pairs that the training kept out: FACTOR and POWER with which 95 % of the errors are within three stated scales."""

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from matcher.network import Matcher
from matcher.pairs import MATCHERS, kept

# Of a Laplace distribution, 95 % are within three scales.
WITHIN = 0.95
# Of each pair, every so many pixels in both directions.
STEP = 4


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, required=True, help="folder of train_matcher.py, with state.pt")
    parser.add_argument("--data", type=Path, required=True, help="first folder of the training, whose first pairs it kept out, or any other")
    return parser.parse_args()


def errors_and_scales(network, folder):
    """Of lit pixels, px."""
    errors, scales = [], []
    for matcher in MATCHERS:
        for inputs, truth, _, lit, _ in kept(folder, matcher):
            with torch.no_grad():
                disparity, log_scale, _ = network(*inputs)
            part = (lit > 0)[0, 0, ::STEP, ::STEP].numpy()
            errors.append(torch.abs(disparity - truth)[0, 0, ::STEP, ::STEP].numpy()[part])
            scales.append(torch.exp(log_scale)[0, 0, ::STEP, ::STEP].numpy()[part])
    return np.concatenate(errors), np.concatenate(scales)


def fit(errors, scales):
    """FACTOR and POWER. The power is that of the largest likelihood, the factor that with which WITHIN holds."""
    best = None
    for power in np.arange(0.5, 1.55, 0.05):
        shape = scales**power
        factor = float(np.quantile(errors / shape, WITHIN)) / 3.0
        surprise = float(np.mean(errors / (factor * shape) + np.log(factor * shape)))
        if best is None or surprise < best[0]:
            best = (surprise, factor, float(power))
    return best[1:]


def main():
    options = arguments()
    network = Matcher().eval()
    network.load_state_dict(torch.load(options.run / "state.pt", weights_only=True)["average"])
    errors, scales = errors_and_scales(network, options.data)
    factor, power = fit(errors, scales)
    within = float((errors < 3 * scales).mean())
    print(json.dumps({"pixels": len(errors), "within_3_scales_before": round(within, 4), "factor": round(factor, 3), "power": round(power, 2)}))


if __name__ == "__main__":
    main()
