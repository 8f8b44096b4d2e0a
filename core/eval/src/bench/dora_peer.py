"""The peer of a node in Python: the same bytes to a Python node of dora and back. Roles: `send WIDTH HEIGHT FRAMES FILE`, `echo`."""

import sys
import time

import numpy as np
import pyarrow as pa
from dora import Node

RATE_HZ = 200.0


def send(width: int, height: int, frames: int, file: str) -> None:
    node = Node()
    picture = pa.array(np.zeros(width * height * 3, np.uint8))
    time.sleep(0.5)
    times_ns = []
    for _ in range(frames):
        begun = time.perf_counter_ns()
        node.send_output("image", picture)
        event = node.next(timeout=10.0)
        while event is not None and event["type"] not in ("INPUT", "STOP"):
            event = node.next(timeout=10.0)
        if event is None or event["type"] == "STOP":
            return
        times_ns.append(time.perf_counter_ns() - begun)
        time.sleep(max(0.0, 1.0 / RATE_HZ - (time.perf_counter_ns() - begun) / 1e9))
    with open(file, "w") as out:
        out.write(f"{np.median(times_ns)}")


def echo() -> None:
    node = Node()
    for event in node:
        if event["type"] == "INPUT":
            node.send_output("image", event["value"], event["metadata"])


if sys.argv[1] == "send":
    send(int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), sys.argv[5])
else:
    echo()
