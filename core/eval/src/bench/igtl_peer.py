"""The peer of `panoscope bench igtl` in Python: a pyigtl server that sends transforms at a rate. Arguments: port, rate in Hz."""

import sys
import time

import numpy as np
import pyigtl

port, rate_hz = int(sys.argv[1]), float(sys.argv[2])
server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
matrix = np.eye(4, dtype=np.float32)
while not server.is_connected():
    time.sleep(0.01)
begun, number = time.perf_counter(), 0
while True:
    number += 1
    matrix[0, 3] = number
    server.send_message(pyigtl.TransformMessage(matrix, device_name="ToolToTracker"), wait=False)
    time.sleep(max(0.0, begun + number / rate_hz - time.perf_counter()))
