"""The process of isolated nodes: ``python -m panoscope.child GROUP``, started by the host with a socket as standard input."""

import sys

if __name__ == "__main__":
    # What a node prints must not mix with the output of the program that runs the graph.
    sys.stdout = sys.stderr
    from panoscope import _native

    _native.serve()
