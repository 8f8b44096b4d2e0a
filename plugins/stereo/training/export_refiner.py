#!/usr/bin/env python3
"""Exports the averaged weights of `train_refiner.py` as the ONNX file of the node `stereo_net`, and compares it with PyTorch."""

import argparse
import json
from pathlib import Path


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, required=True, help="folder of train_refiner.py, with state.pt")
    parser.add_argument("--out", type=Path, required=True, help="ONNX file to write")
    parser.add_argument("--card", type=Path, help="card of the model: steps and minutes between its marks are renewed")
    return parser.parse_args()


def export(network, file):
    """Writes the file; any size whose sides are multiples of 32 fits."""
    import torch

    # Sizes differ, so that no axis is taken for another.
    views = [torch.rand(1, 1, 96, 128) for _ in range(2)]
    maps = [torch.full((1, 1, 96, 128), 6.0) for _ in range(2)]
    names, outputs = ["left", "right", "disparity", "disparity_right"], ["refined", "scale", "occlusion"]
    axes = {name: {2: "rows", 3: "columns"} for name in names + outputs}
    torch.onnx.export(network, (*views, *maps), str(file), input_names=names, output_names=outputs, dynamic_axes=axes, opset_version=17, dynamo=False)


def largest_difference(network, file):
    """Of the file's answers from PyTorch's on a size that was not exported, relative to the answers."""
    import numpy as np
    import onnxruntime
    import torch

    random = np.random.default_rng(1)
    size = (1, 1, 160, 224)
    inputs = [random.random(size, np.float32) for _ in range(2)]
    inputs += [np.where(random.random(size) < 0.3, -10000, 5 + 20 * random.random(size)).astype(np.float32) for _ in range(2)]
    with torch.no_grad():
        expected = [out.numpy() for out in network(*map(torch.from_numpy, inputs))]
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    found = session.run(None, dict(zip(["left", "right", "disparity", "disparity_right"], inputs)))
    return max(float((np.abs(a - b) / (1 + np.abs(a))).max()) for a, b in zip(expected, found))


def renew(card, state, parameters):
    """Writes what the checkpoint knows between the marks of the card."""
    begin, end = "<!-- training -->", "<!-- /training -->"
    text = card.read_text()
    before, rest = text.split(begin, 1)
    about = f"{parameters} parameters, {state['step']} steps, {state['minutes']:.0f} minutes"
    card.write_text(before + begin + about + end + rest.split(end, 1)[1])


def main():
    options = arguments()
    import torch

    from refiner.network import Refiner

    state = torch.load(options.run / "state.pt", weights_only=True)
    network = Refiner().eval()
    network.load_state_dict(state["average"])
    export(network, options.out)
    parameters = sum(p.numel() for p in network.parameters())
    difference = largest_difference(network, options.out)
    print(json.dumps({"bytes": options.out.stat().st_size, "parameters": parameters, "steps": state["step"], "difference": difference}))
    if difference > 1e-3:
        raise SystemExit(f"{options.out} answers otherwise than PyTorch")
    if options.card:
        renew(options.card, state, parameters)


if __name__ == "__main__":
    main()
