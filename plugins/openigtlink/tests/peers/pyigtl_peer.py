"""A program on pyigtl at the other end of a connection.

    pyigtl_peer.py serve PORT     sends a client one message of each type that pyigtl knows, again and again
    pyigtl_peer.py listen PORT    connects and prints the messages that arrive, until each type has
"""

import sys
import time

import numpy as np
import pyigtl

TURN = np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], dtype=np.float32)
PIXELS = (np.arange(18, dtype=np.uint8) * 10).reshape(1, 2, 3, 3)


def serve(port, version):
    server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    print("listening", flush=True)
    while True:
        if server.is_connected():
            messages = [
                pyigtl.TransformMessage(TURN, device_name="ToolToTracker"),
                pyigtl.ImageMessage(PIXELS, device_name="Video"),
                pyigtl.StringMessage("a text", device_name="Words"),
                pyigtl.PointMessage(positions=[[1.5, -2.5, 3.5]], names=["Target"], diameters=[4], device_name="Targets"),
                pyigtl.PolyDataMessage(
                    points=np.array([[0, 0, 50], [1, 0, 50], [0, 1, 50]], dtype=np.float32),
                    polygons=np.array([3, 0, 1, 2], dtype=np.uint32),
                    device_name="Mesh",
                ),
            ]
            for message in messages:
                message.header_version = version
                message.metadata = {"from": "pyigtl"} if version > 1 else {}
                server.send_message(message, wait=False)
        time.sleep(0.02)


def words(message):
    if message.message_type == "TRANSFORM":
        return " ".join(f"{value:.2f}" for value in message.matrix[:3].flatten())
    if message.message_type == "IMAGE":
        return f"{message.image.shape} {message.image.dtype} first {message.image.flatten()[:3].tolist()} sum {int(message.image.sum())}"
    if message.message_type == "STRING":
        return message.string
    if message.message_type == "POINT":
        rows = zip(message.names, message.positions, message.diameters, message.owners)
        return " ".join(f"{name} {at[0]:.2f} {at[1]:.2f} {at[2]:.2f} r {size:.2f} of {owner}" for name, at, size, owner in rows)
    return "?"


def listen(port, wanted):
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
    print("connected", flush=True)
    seen = set()
    end = time.time() + 60
    while seen != wanted and time.time() < end:
        for message in client.get_latest_messages():
            if message.device_name in wanted - seen:
                seen.add(message.device_name)
                metadata = "".join(f" {key}={value}" for key, value in sorted(message.metadata.items()) if key != "capture_ns")
                print(message.message_type, message.device_name, words(message) + metadata, flush=True)
        time.sleep(0.005)
    print("done", flush=True)
    client.stop()


def main():
    what, port = sys.argv[1], int(sys.argv[2])
    if what == "serve":
        serve(port, int(sys.argv[3]))
    else:
        listen(port, set(sys.argv[3:]))


main()
