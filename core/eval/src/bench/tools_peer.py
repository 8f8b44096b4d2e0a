"""What `panoscope bench tools` is measured beside: plain ONNX Runtime, OpenCV and NumPy doing the work of one node."""
import json
import sys
import time

import cv2
import numpy as np
import onnxruntime

node, model, picture, frames, threads = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
cv2.setNumThreads(threads)
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = threads
options.log_severity_level = 3
session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
entry = session.get_inputs()[0]
height, width = [d if isinstance(d, int) else s for d, s in zip(entry.shape[-2:], (480, 640))]
frame = cv2.imread(picture)
network = []
# Filled once: each frame covers the same part of it.
canvas = np.full((height, width, 3), 114, np.uint8)


def fit(rgb):
    """Kept in proportion, upper left, gray 114 beside."""
    h, w = frame.shape[:2]
    scale = min(width / w, height / h)
    size = (round(w * scale), round(h * scale))
    part = canvas[: size[1], : size[0]]
    if size == (w, h):
        part[:] = frame
    else:
        part[:] = cv2.resize(frame, size, interpolation=cv2.INTER_LINEAR)
    if rgb:
        return cv2.dnn.blobFromImage(canvas, 1 / 255.0, swapRB=True), scale
    return cv2.dnn.blobFromImage(canvas), scale


def infer(blob):
    if len(entry.shape) == 3:
        blob = blob[0]
    begun = time.perf_counter()
    answer = session.run(None, {entry.name: blob})
    network.append(time.perf_counter() - begun)
    return answer


grids = [np.stack(np.meshgrid(np.arange(width // s), np.arange(height // s)), -1).reshape(-1, 2) for s in (8, 16, 32)]
steps = np.concatenate([np.full(len(g), s, np.float32) for g, s in zip(grids, (8, 16, 32))])
grid = np.concatenate(grids).astype(np.float32)


def yolo(limit=0.3):
    """YOLOX, boxes relative to the grid."""
    blob, scale = fit(False)
    raw = infer(blob)[0][0]
    raw, g, s = raw[raw[:, 4] > limit], grid[raw[:, 4] > limit], steps[raw[:, 4] > limit]
    kinds = raw[:, 5:].argmax(1)
    scores = raw[:, 4] * raw[np.arange(len(raw)), 5 + kinds]
    good = scores > limit
    centre = (raw[good, :2] + g[good]) * s[good, None]
    size = np.exp(raw[good, 2:4]) * s[good, None]
    boxes = np.concatenate((centre - size / 2, size), 1) / scale
    kept = cv2.dnn.NMSBoxesBatched(boxes.tolist(), scores[good].tolist(), kinds[good].tolist(), limit, 0.5)
    return len(kept)


def mask_rcnn(limit=0.5):
    blob, scale = fit(True)
    answer = dict(zip([o.name for o in session.get_outputs()], infer(blob)))
    boxes, scores, masks = answer["boxes"] / scale, answer["scores"], answer["masks"]
    h, w = frame.shape[:2]
    out = []
    for b, m in zip(boxes[scores > limit], masks[scores > limit]):
        x0, y0, x1, y1 = (int(v) for v in (max(0, b[0]), max(0, b[1]), min(w, b[2] + 1), min(h, b[3] + 1)))
        if x1 <= x0 or y1 <= y0:
            continue
        whole = np.zeros((h, w), np.uint8)
        whole[y0:y1, x0:x1] = cv2.resize(m[0], (x1 - x0, y1 - y0)) >= 0.5
        out.append(np.packbits(whole, 1))
    return len(out)


work = yolo if node == "yolo" else mask_rcnn
found = work()
work()
network.clear()
times = []
for _ in range(frames):
    begun = time.perf_counter()
    work()
    times.append(time.perf_counter() - begun)
print(json.dumps({"frame_ms": 1e3 * float(np.median(times)), "network_ms": 1e3 * float(np.median(network)), "found": int(found)}))
