#!/usr/bin/env python3
"""Exports the averaged weights of `train_matcher.py` as the ONNX file of the node `stereo_net`, and compares it with PyTorch."""

import argparse
import json
from pathlib import Path

import numpy as np
import onnxruntime
import torch

from matcher.network import UNKNOWN, Exported, Matcher

INPUTS, OUTPUTS = ["left", "right", "filled", "known"], ["disparity", "scale", "occlusion"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, required=True, help="folder of train_matcher.py, with state.pt")
    parser.add_argument("--out", type=Path, required=True, help="ONNX file to write")
    parser.add_argument("--scale", type=float, nargs=2, default=(1.0, 1.0), metavar=("FACTOR", "POWER"), help="of `fit_scale.py`: scales are FACTOR times the network's, to POWER")
    return parser.parse_args()


def export(network, file):
    """Writes the file; any size whose sides are multiples of 32 fits."""
    # Sides differ, so that no axis is taken for another.
    inputs = (*(torch.rand(1, 3, 96, 128) for _ in range(2)), torch.full((1, 1, 96, 128), 20.0), torch.ones(1, 1, 96, 128))
    axes = {name: {2: "rows", 3: "columns"} for name in INPUTS + OUTPUTS}
    torch.onnx.export(network, inputs, str(file), input_names=INPUTS, output_names=OUTPUTS, dynamic_axes=axes, opset_version=17, dynamo=False)


def largest_difference(network, file):
    """Of the file's answers from PyTorch's on a size that was not exported, relative to the answers."""
    random = np.random.default_rng(1)
    rough = random.random((1, 3, 20, 40), np.float32)
    left = np.kron(rough, np.ones((1, 1, 8, 8), np.float32))[:, :, :, 64:]
    right = np.roll(left, -11, 3)
    filled = (11 + random.random((1, 1, 160, 256))).astype(np.float32)
    filled[:, :, :40] = UNKNOWN
    known = ((filled > 0) & (random.random(filled.shape) < 0.7)).astype(np.float32)
    inputs = (left, right, filled, known)
    with torch.no_grad():
        expected = [out.numpy() for out in network(*map(torch.from_numpy, inputs))]
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    found = session.run(OUTPUTS, dict(zip(INPUTS, inputs)))
    return max(float((np.abs(a - b) / (1 + np.abs(a))).max()) for a, b in zip(expected, found))


def main():
    options = arguments()
    state = torch.load(options.run / "state.pt", weights_only=True)
    matcher = Matcher().eval()
    matcher.load_state_dict(state["average"])
    network = Exported(matcher, *options.scale)
    export(network, options.out)
    parameters = sum(p.numel() for p in matcher.parameters())
    difference = largest_difference(network, options.out)
    print(json.dumps({"bytes": options.out.stat().st_size, "parameters": parameters, "steps": state["step"], "minutes": state["minutes"], "difference": difference}))
    if difference > 1e-3:
        raise SystemExit(f"{options.out} answers otherwise than PyTorch")


if __name__ == "__main__":
    main()
