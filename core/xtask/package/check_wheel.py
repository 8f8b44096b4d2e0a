"""Runs in the environment that a wheel was installed in: writes what graphs gave to a file, and fails where something does not work."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import panoscope as ps

out, frames = Path(sys.argv[1]), int(sys.argv[2])


def fingerprints(result: ps.Result) -> dict:
    return {output: {str(packet.tick): packet.fingerprint for packet in result[output].packets()} for output in result}


result = ps.Graph("panorama.toml").run(frames=frames, watch=["scope.left", "wide.panorama"])
assert not result.faults, result.faults
panorama = result["wide.panorama"][0]
assert panorama.dtype == np.uint8 and panorama.shape[1] > result["scope.left"][0].shape[1], panorama.shape
out.write_text(json.dumps(fingerprints(result)))
print(f"panorama.toml: {len(result['wide.panorama'])} panoramas of {panorama.shape[1]}x{panorama.shape[0]}")

found = ps.Graph("tools.toml").run(frames=2, watch=["instruments.detections"])["instruments.detections"]
print(f"tools.toml: {[len(one.boxes) for one in found]} instruments, by the ONNX Runtime of the wheel")

with tempfile.TemporaryDirectory() as folder:
    Path(folder, "mine.py").write_text(
        "import panoscope as ps\n@ps.node()\nclass Invert:\n    def process(self, image: ps.Bgr8) -> ps.Bgr8:\n        return 255 - image\n"
    )
    graph = Path(folder, "mine.toml")
    graph.write_text(
        'mode = "batch"\nplugin_paths = ["."]\nplugins = ["phantom", "mine"]\n[nodes.scope]\ntype = "phantom"\n'
        '[nodes.inverse]\ntype = "invert"\ninputs = { image = "scope.left" }\n'
    )
    result = ps.Graph(graph).run(frames=2, watch=["scope.left", "inverse.image"])
    np.testing.assert_array_equal(255 - result["scope.left"].stack(), result["inverse.image"].stack())
    print("a node in Python: runs in this environment's interpreter")
    graph.write_text('plugins = ["sinks", "opencv"]\n')
    try:
        ps.check(graph)
    except ps.GraphError as error:
        for library in ("libgst", "libopencv"):
            assert library in str(error), error
        print(f"without OpenCV and GStreamer: {error.diagnostics[0].message}; {error.diagnostics[0].help}")
    else:
        raise AssertionError("the system has OpenCV and GStreamer, so this proves nothing")

command = Path(sys.executable).with_name("panoscope")
print(subprocess.run([command, "--version"], check=True, capture_output=True, text=True).stdout.strip())
subprocess.run([command, "describe", "register_surf"], check=True, capture_output=True)
