"""A slider over the packets of a series, where ipywidgets is installed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import pages
from .progress import shell

if TYPE_CHECKING:
    from .series import Series

_VIEW = "application/vnd.jupyter.widget-view+json"


def slider(series: Series) -> dict[str, Any]:
    """What a notebook shows of it; nothing without a notebook or ipywidgets."""
    if shell() is None:
        return {}
    try:
        import ipywidgets  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ImportError:
        return {}
    place = ipywidgets.IntSlider(0, 0, len(series) - 1, description="packet", continuous_update=True)
    picture = ipywidgets.HTML(pages.of_packet(series.packet(0)))

    def show(change: Any) -> None:
        picture.value = pages.of_packet(series.packet(change["new"]))

    place.observe(show, names="value")
    bundle: Any = ipywidgets.VBox([place, picture])._repr_mimebundle_()
    bundle = bundle[0] if isinstance(bundle, tuple) else bundle
    return {_VIEW: bundle[_VIEW]} if bundle and _VIEW in bundle else {}
