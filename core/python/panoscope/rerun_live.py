"""A running graph in rerun (https://rerun.io), with the package ``rerun-sdk``: ``python -m panoscope.rerun_live GRAPH``.

Outputs go to a viewer that runs already (``rerun``), or to a file. Entities, archetypes and timelines are those of :mod:`panoscope.rerun_file`. Of
a live graph the newest packets are shown while rerun takes its time: the graph never waits.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .errors import PanoscopeError
from .graph import Graph
from .rerun_file import _Entity, _rerun

VIEWER = "rerun+http://127.0.0.1:9876/proxy"
"""A viewer on this machine."""


def show(
    graph: Graph,
    *,
    connect: str | None = None,
    save: str | os.PathLike[str] | None = None,
    ports: Sequence[str] = (),
    frames: int | None = None,
    act: bool | None = None,
    paced: bool = True,
) -> dict[str, int]:
    """Runs a graph and logs its outputs to a viewer, by default to one on this machine, or to a file. Returns the packets of each output.

    ``ports`` names outputs; without it all that rerun can show are taken, so that all nodes that make them run. ``frames`` and ``act`` are as for
    :meth:`Graph.start`.
    """
    rerun = _rerun()
    entity = _Entity(rerun)
    outputs = graph.outputs
    missing = [port for port in ports if port not in outputs]
    if missing:
        raise PanoscopeError(f"the graph has no output `{missing[0]}`; it has {', '.join(outputs)}")
    unknown = [port for port in ports if not hasattr(_Entity, outputs[port])]
    if unknown:
        raise PanoscopeError(f"packets of type `{outputs[unknown[0]]}` (`{unknown[0]}`) are known to their plugin only")
    watch = list(ports) or [port for port, packet in outputs.items() if hasattr(_Entity, packet)]
    stream = rerun.RecordingStream("panoscope")
    counts = dict.fromkeys(watch, 0)
    try:
        if save is not None:
            stream.save(save)
        else:
            stream.connect_grpc(connect or VIEWER)
        with graph.start(watch, frames=frames, act=act, paced=paced) as running:
            for packet in running:
                stream.set_time("tick", sequence=packet.tick)
                stream.set_time("capture", duration=np.timedelta64(packet.capture_ns, "ns"))
                parts = packet.output.replace(".", "/").split("/")
                for below, shown in getattr(entity, outputs[packet.output])(packet.value):
                    stream.log([*parts, *below], *shown)
                counts[packet.output] += 1
        stream.flush(timeout_sec=10)
    finally:
        stream.disconnect()
    return counts


def _words(rest: Sequence[str]) -> Mapping[str, str]:
    """``--set node.param=value`` as values by parameter."""
    pairs = [setting.partition("=") for setting in rest]
    for name, equals, _ in pairs:
        if not equals:
            raise PanoscopeError(f"`--set {name}` has no value: write node.param=value")
    return {name: value for name, _, value in pairs}


def main() -> None:
    """What ``python -m panoscope.rerun_live`` runs."""
    import argparse
    import json

    parser = argparse.ArgumentParser(prog="python -m panoscope.rerun_live", description="Shows a running graph in rerun.")
    parser.add_argument("graph")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--connect", metavar="URL", help=f"a viewer; without it {VIEWER}, where `rerun --bind 127.0.0.1` listens")
    where.add_argument("--save", metavar="FILE.rrd", help="a file instead of a viewer")
    parser.add_argument("--port", action="append", default=[], metavar="NODE.PORT", help="only this output; may be given again")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAM=VALUE", help="sets a parameter; may be given again")
    parser.add_argument("--frames", type=int, metavar="N", help="ticks that each source makes")
    parser.add_argument("--unpaced", action="store_true", help="as fast as the graph takes frames")
    parser.add_argument("--act", action="store_true", help="runs all nodes, also those that write files or move things")
    given = parser.parse_args()
    logging.basicConfig(format="%(levelname)s %(message)s")

    def value(text: str) -> Any:
        try:
            return json.loads(text)
        except ValueError:
            return text

    try:
        graph = Graph(given.graph, set={name: value(text) for name, text in _words(given.set).items()})
        counts = show(
            graph,
            connect=given.connect,
            save=given.save,
            ports=given.port,
            frames=given.frames,
            act=True if given.act else None,
            paced=not given.unpaced,
        )
    except PanoscopeError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    for port, count in counts.items():
        print(f"{port}: {count}")


if __name__ == "__main__":
    main()
