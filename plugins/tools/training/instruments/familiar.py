"""How a network sees pictures, by its file in ONNX Runtime: the numbers that say how unlike they are to those that it learned from. Needs onnxruntime."""

import numpy as np

from . import pictures
from .data import read


class Session:
    """The file in ONNX Runtime; takes pictures as `placed` gives them."""

    def __init__(self, path, threads):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.is_torchvision = self.session.get_modelmeta().custom_metadata_map.get("family") == "torchvision"

    def __call__(self, x):
        return self.session.run(["output"], {"images": x})[0]

    def features(self, x):
        # Segmenters take red first and 0..1.
        x = np.ascontiguousarray(x[:, ::-1]) / np.float32(255) if self.is_torchvision else x
        return self.session.run([pictures.OUTPUT], {"images": x})[0][0]


def placed(frame, width, height):
    """A picture as the `yolo` node gives it to its network, and the width and height that it has there."""
    import cv2

    h, w = frame.shape[:2]
    scale = min(width / w, height / h)
    size = (max(1, round(w * scale)), max(1, round(h * scale)))
    out = np.full((height, width, 3), 114, np.float32)
    out[: size[1], : size[0]] = cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return out.transpose(2, 0, 1)[None], size


def picture_features(session, frame, width, height):
    """The numbers by which pictures are compared, of one picture."""
    x, size = placed(frame, width, height)
    return pictures.mean_features(session.features(x), size)


def learned_from(path, folder, width, height, threads, most):
    """Statistics of the pictures in `folder`, at most `most` of them, evenly taken; each operation, or rendered scene in a folder of its own, counts
    alike."""
    import cv2

    found = {}
    for split in ("trainval", "train", "val", "test"):
        try:
            found |= {f.path: f for f in read(folder, split)}
        except FileNotFoundError:
            continue
    frames = [found[path] for path in sorted(found)]
    if not frames:
        raise SystemExit(f"{folder}: no frames of a split trainval, train, val or test")
    frames = frames[:: -(-len(frames) // most)]
    session = Session(path, threads)
    rows = [picture_features(session, cv2.imread(str(f.path)), width, height) for f in frames]
    folders = [f.path.parent.name for f in frames]
    groups = folders if len(set(folders)) > 1 else [f.group for f in frames]
    statistics = pictures.Statistics.with_limit(rows, groups)
    print(f"{folder}: {len(rows)} pictures of {len(set(groups))} operations or scenes; unlike them from {statistics.limit:.2f} on")
    return statistics
