"""ONNX files after export: metadata, and weights kept in half the bytes."""

import inspect
import warnings

import numpy as np
import onnx
from onnx import helper, numpy_helper

from .pictures import OUTPUT as FEATURES

# Channels of EfficientNet-Lite0 at stride 8.
SEGMENTER_CHANNELS = 40


def export(model, x, path, outputs, **options):
    """Writes `model` as an ONNX file with the input `images`, by the exporter that every version of PyTorch has."""
    import torch

    # PyTorch 2 has a second exporter, which needs another package.
    other = {"dynamo": False} if "dynamo" in inspect.signature(torch.onnx.export).parameters else {}
    with torch.no_grad(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The shape inference of prim::Constant")
        torch.onnx.export(model, x, str(path), opset_version=13, input_names=["images"], output_names=outputs, **options, **other)


def store_half(graph, least=64):
    """Turns f32 weights of at least `least` values into 16-bit floats, widened again by a Cast that the reader's runtime does once, at opening."""
    casts = []
    for i, tensor in enumerate(graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(tensor)
        small = values.astype(np.float16)
        if values.size < least or not np.isfinite(small).all():
            continue
        stored = numpy_helper.from_array(small, f"{tensor.name}_half")
        casts.append(helper.make_node("Cast", [stored.name], [tensor.name], to=onnx.TensorProto.FLOAT))
        graph.initializer[i].CopyFrom(stored)
    nodes = list(graph.node)
    del graph.node[:]
    graph.node.extend(casts + nodes)


def add_features(graph):
    """Adds the output `features` (see pictures.py): what the first convolution of stride 16 reads, averaged over 4 x 4 cells. Of a segmenter, whose
    file does not say its sizes, it is the end of the backbone's stage of stride 8."""
    if any(o.name == FEATURES for o in graph.output):
        return
    stage = [n.output[0] for n in graph.node if n.op_type == "Add" and "/stages.2/" in n.output[0]]
    if stage:
        height, width = [d.dim_value for d in graph.input[0].type.tensor_type.shape.dim][2:]
        return append_features(graph, stage[-1], SEGMENTER_CHANNELS, height // 32, width // 32)
    inferred = onnx.shape_inference.infer_shapes(helper.make_model(graph)).graph
    sizes = {v.name: [d.dim_value for d in v.type.tensor_type.shape.dim] for v in (*inferred.value_info, *inferred.input, *inferred.output)}
    height, width = sizes[graph.input[0].name][2:]
    is_coarse = lambda name: sizes.get(name, [])[2:] == [height // 16, width // 16]
    fine = next((n.input[0] for n in graph.node if n.op_type == "Conv" and is_coarse(n.output[0])), None)
    channels, rows, columns = (sizes.get(fine) or [0] * 4)[1:]
    if (rows, columns) != (height // 8, width // 8):
        raise ValueError("the graph has no convolution from stride 8 to stride 16: it is no detector of the YOLOX family")
    append_features(graph, fine, channels, rows // 4, columns // 4)


def append_features(graph, fine, channels, rows, columns):
    """Adds the output `features`: the mean of `fine` over 4 x 4 cells."""
    graph.node.append(helper.make_node("AveragePool", [fine], [FEATURES], kernel_shape=[4, 4], strides=[4, 4]))
    graph.output.append(helper.make_tensor_value_info(FEATURES, onnx.TensorProto.FLOAT, [1, channels, rows, columns]))


def write(path, metadata, change=None):
    """Adds `metadata` to the file at `path`, applies `change` to its graph, checks it and writes it again, without doc strings."""
    write_model(onnx.load(str(path)), path, metadata, change)


def write_model(model, path, metadata, change=None):
    """The same with a model that is loaded."""
    for node in model.graph.node:
        node.doc_string = ""
    if change:
        change(model.graph)
    del model.metadata_props[:]
    helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def write_card(path, title, metadata, measured):
    """A model card beside the file: what it is, what it learnt from, its licence note, what was measured, where it fails."""
    facts = "\n".join(f"| {k} | {v} |" for k, v in metadata.items() if k not in ("description", "batch", "pictures"))
    scores = "\n".join(f"- {line}" for line in measured) or "- nothing yet: run `panoscope eval detect`"
    path.write_text(
        f"""# {title}

{metadata["description"]}. Research software, no medical device: never to be relied on in an operation.

| | |
|---|---|
{facts}

## Measured

{scores}

`panoscope eval detect` measures it again, with curves, confusions and the worst misses.

## Limits

- Trained on cholecystectomies filmed by few endoscopes: other operations, instruments and light are found less well. Frames of operations that it
  saw in training score higher than those of others; the figure on operations left out is the one to expect.
- Seven kinds of instruments; clips, gauze, drains and trocars are none of them and may be taken for one.
- Smoke, blood on the lens, glare and instruments at the rim of the picture are missed more often.
"""
    )
