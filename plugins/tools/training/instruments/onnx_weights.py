"""Weights out of an ONNX export, with NumPy and onnx alone."""

import numpy as np


def convolutions(graph):
    """Name, weight and bias of every convolution of a graph, in the order in which they are computed, as f32.

    A weight that is stored in half the bytes and widened by a Cast (see onnx_store.store_half) is widened here.
    """
    from onnx import numpy_helper

    stored = {tensor.name: tensor for tensor in graph.initializer}
    widened = {node.output[0]: node.input[0] for node in graph.node if node.op_type == "Cast" and node.input[0] in stored}

    def values(name):
        tensor = stored.get(widened.get(name, name))
        if tensor is None:
            raise ValueError(f"`{name}` is computed in the file, not stored: its normalisations are not folded")
        return numpy_helper.to_array(tensor).astype(np.float32)

    found = []
    for node in graph.node:
        if node.op_type == "Conv":
            if len(node.input) < 3:
                raise ValueError(f"{node.name} has no bias: its normalisation is not folded")
            found.append((node.name, values(node.input[1]), values(node.input[2])))
    return found


def narrow_stem(wide):
    """The first convolution as it was trained: over four interleaved pictures, 3 x 3. Undoes folding.wide_stem."""
    out, channels, height, width = wide.shape
    if (channels, height, width) != (3, 6, 6):
        raise ValueError(f"the first convolution is {wide.shape}: 3 channels and 6 x 6 px were expected")
    narrow = np.zeros((out, 12, 3, 3), np.float32)
    for group, (dy, dx) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        narrow[:, 3 * group : 3 * group + 3] = wide[:, :, dy::2, dx::2]
    return narrow
