"""ONNX files after export: metadata, and weights kept in half the bytes."""

import numpy as np
import onnx
from onnx import helper, numpy_helper


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


def write(path, metadata, change=None):
    """Adds `metadata` to the file at `path`, applies `change` to its graph, checks it and writes it again, without doc strings."""
    model = onnx.load(str(path))
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
    facts = "\n".join(f"| {k} | {v} |" for k, v in metadata.items() if k not in ("description", "batch"))
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
