"""Document of one page of the console: two slices, the strips, and the link to its controls."""

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import ColumnDataSource, CustomJS, FactorRange, LinearColorMapper, Range1d
from bokeh.palettes import Greys256
from bokeh.plotting import figure
from numpy.typing import NDArray

from sonoservo.systems.display.colours import (
    CROSS_SECTION,
    ESTIMATE,
    FORCE,
    MODE_COLOURS,
    SECTOR,
    STOPPED,
    TRUTH,
    UNCERTAINTY,
    hexadecimal,
)
from sonoservo.systems.display.console.readings import STRIPS, Frame, shown_number
from sonoservo.systems.signals.needle_colours import LINE_COLOURS

_GROUND, _PLOT, _INK, _GRID = "#10141a", "#0a0d11", "#aeb7c2", "#242c36"
_FIRST, _SECOND = "#58b4f0", "#f0a35e"
_MODES = [str(mode) for mode in MODE_COLOURS]
_COLOURS = {str(mode): hexadecimal(colour) for mode, colour in MODE_COLOURS.items()}
_PAGE_COLOURS = {
    **{str(mode): colour for mode, colour in MODE_COLOURS.items()},
    "stopped": STOPPED, "truth": TRUTH, "sector": SECTOR, "uncertainty": UNCERTAINTY,
    "force": FORCE, "cross-section": CROSS_SECTION,
}  # fmt: skip
_DASHES = {"tracking": "solid", "coasting": "dashed", "lost": "dotted"}
_HEARD: Mapping[str, Any] = {"order": {}, "drawn": -1}
_LONGEST = 0.5  # Longest time before a sample for which its mode is drawn, in s
_RING = 2.5  # Radius of the ring at the tip, in mm
# Name, axis, lines (column, colour and label) and smallest range of each strip; None is 0 to 1.
_LINES: Sequence[tuple[str, str, Sequence[tuple[str, str, str]], float | None]] = (
    ("features", "X, Z (mm)", (("x", _FIRST, "X"), ("z", _SECOND, "Z")), 2.0),
    ("angle", "Theta (deg)", (("theta", _FIRST, ""),), 4.0),
    ("force", "force (N)", (("force", _FIRST, "force"), ("target", _SECOND, "target")), 1.0),
    ("error", "error (mm)", (("error", _FIRST, ""),), 0.5),
    ("probability", "P(needle)", (("probability", _FIRST, ""),), None),
)
CHARTS = {"chart_x": "x", "chart_y": "y"}
"""Charts of the deflection along an axis over the depth."""

_SCRIPTS = ("console.js", "controls.js", "views.js")  # Scripts of the page, which share one scope


class PageDocument:
    """Models of one page of the console, in a Bokeh document.

    The values that a page and the console set for each other are the tags of `models` that draw
    nothing; all that changes at a time goes as one message, because Bokeh spends a millisecond on
    each.
    """

    def __init__(self, document: Document, title: str) -> None:
        self.document = document
        self.models = {name: ColumnDataSource() for name in ("state", "described")} | {
            name: ColumnDataSource(tags=[value]) for name, value in _HEARD.items()
        }
        self._strips = _source(*STRIPS, "colour", "begin")
        self._time: float | None = None
        grey = LinearColorMapper(palette=Greys256, low=0, high=255, name="grey")
        roots = (
            {f"slice_{number}": _slice_figure(grey) for number in range(2)}
            | self._strip_figures()
            | _chart_figures()
        )
        # They belong to the document, and follow its changes, only if one of its roots names them.
        roots["mode"].tags = list(self.models.values())
        with document.models.freeze():
            for name, root in roots.items():
                root.name = name
                document.add_root(root)
        for model in document.models:
            model.syncable = model in self.models.values()
        document.title = title
        document.template = page_template()
        document.config.reconnect_session = False
        document.config.notify_connection_status = False
        start = CustomJS(
            args={"link": self.models, "grey": grey, "figures": roots},
            code="window.sonoservo.start(link, grey, figures)",
        )
        document.js_on_event("document_ready", start)

    def heard(self, name: str) -> Any:
        """Return a value from the page; None if it has sent nothing of the kind."""
        tags = self.models[name].tags
        return tags[0] if tags and isinstance(tags[0], type(_HEARD[name])) else None

    def send(self, name: str, value: Mapping[str, Any], *images: NDArray[np.uint8]) -> None:
        """Send a value to the page, with images that follow it."""
        self.models[name].tags = [json.dumps(value, default=float), *images]

    def on_change(self, name: str, callback: Callable[[], None]) -> None:
        """Call a function whenever the page has set a value."""
        self.models[name].on_change("tags", lambda attribute, old, new: callback())

    def show(
        self,
        state: Mapping[str, Any],
        *,
        frame: Frame | None = None,
        strips: Mapping[str, list[Any]] | None = None,
        anew: bool = False,
        keep: int = 1,
    ) -> None:
        """Send a state, and what has changed with it."""
        message, images = dict(state), list[NDArray[np.uint8]]()
        if frame is not None:
            message["frame"], images = _describe_frame(frame)
        if strips is not None:
            message["strips"] = {"columns": self._columns(strips, anew), "anew": anew, "keep": keep}
        self.send("state", message, *images)

    def _columns(self, samples: Mapping[str, list[Any]], anew: bool) -> dict[str, list[Any]]:
        columns: dict[str, list[Any]] = {
            name: [value if isinstance(value, str) else shown_number(value) for value in each]
            for name, each in samples.items()
        }
        columns["colour"] = [_COLOURS.get(str(mode), _INK) for mode in columns["mode"]]
        begins = [self._time if not anew else None, *columns["time"]]
        if columns["time"]:
            self._time = columns["time"][-1]
        columns["begin"] = [
            time - _LONGEST if begin is None else max(begin, time - _LONGEST)
            for begin, time in zip(begins, columns["time"], strict=False)
        ]
        return columns

    def _strip_figures(self) -> dict[str, Any]:
        time = Range1d(0, 10, name="time")
        plots = {}
        for name, label, lines, least in _LINES:
            low, high = (-0.05, 1.05) if least is None else (-0.5 * least, 0.5 * least)
            plots[name] = plot = _plot(time, Range1d(low, high), "time (s)", label, tags=[least])
            for column, colour, text in lines:
                dash = "dashed" if column in ("z", "target") else "solid"
                legend = {"legend_label": text} if text else {}
                plot.line("time", column, source=self._strips, line_color=colour, line_width=1.6,
                          line_dash=dash, **legend)  # fmt: skip
            if plot.legend:
                _style_legend(plot)
            plot.xaxis.visible = False
        plots["mode"] = modes = _plot(time, FactorRange(*reversed(_MODES)), "time (s)", None)
        modes.ygrid.visible = False
        modes.hbar(left="begin", right="time", y="mode", source=self._strips, height=0.7,
                   fill_color="colour", line_color="colour")  # fmt: skip
        return plots


def _slice_figure(grey: LinearColorMapper) -> Any:
    plot = _plot(Range1d(-50, 50), Range1d(80, 0), None, None)
    plot.min_border_left = plot.min_border_right = None
    plot.background_fill_color = "#000000"
    plot.grid.visible = False
    plot.image(source=_source("image", "x", "y", "dw", "dh"), color_mapper=grey)
    plot.multi_line("xs", "ys", source=_source("xs", "ys"), line_width=2, name="rails")
    plot.circle("x", "y", radius=_RING, source=_source("x", "y"), fill_color=None, line_width=2,
                name="ring")  # fmt: skip
    plot.multi_line("xs", "ys", source=_source("xs", "ys", "colour"), line_color="colour",
                    line_width=1.5, line_alpha=0.8, name="lines")  # fmt: skip
    return plot


def _chart_figures() -> dict[str, Any]:
    """Return the charts of a needle's deflection over its depth, which share their axes."""
    depth, deflection = Range1d(0, 100), Range1d(-2, 2)
    plots = {}
    for name, axis in CHARTS.items():
        label = f"deflection {axis.upper()} (mm)"
        plots[name] = plot = _plot(depth, deflection, "depth (mm)", label)
        path = _source("depth", axis, f"{axis}_low", f"{axis}_high")
        plot.varea("depth", f"{axis}_low", f"{axis}_high", source=path, fill_alpha=0.35,
                   fill_color=hexadecimal(ESTIMATE), name="path", legend_label="95 %")  # fmt: skip
        plot.line("depth", axis, source=path, line_color=hexadecimal(ESTIMATE), line_width=2,
                  legend_label="predicted")  # fmt: skip
        plot.scatter("depth", axis, source=_source("depth", axis), size=3, line_color=None,
                     fill_color=hexadecimal(CROSS_SECTION), name="found",
                     legend_label="found")  # fmt: skip
        plot.line("depth", axis, source=_source("depth", axis), line_color=hexadecimal(TRUTH),
                  line_width=2, line_dash="dashed", name="true", legend_label="true")  # fmt: skip
        _style_legend(plot)
    return plots


def _source(*columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns})


def page_template() -> str:
    """Return the template of the page, with its style and its script."""
    folder = files("sonoservo.systems.display.console")
    text = (folder / "console.html").read_text()
    colours = "".join(f"--{name}: {hexadecimal(each)}; " for name, each in _PAGE_COLOURS.items())
    text = text.replace("/* colours */", f":root {{ {colours}}}")
    scripts = "\n".join((folder / name).read_text() for name in _SCRIPTS)
    text = text.replace("/* console.css */", (folder / "console.css").read_text())
    return text.replace("/* scripts */", scripts)


def _describe_frame(frame: Frame) -> tuple[dict[str, Any], list[NDArray[np.uint8]]]:
    """Return the pictures of a volume in words for the page's script, and their images."""
    pictures = [
        picture and {
            "title": picture.title,
            "axes": [f"{axis} (mm)" for axis in picture.axes],
            "corner": picture.corner,
            "size": picture.size,
            "window": picture.window,
            "rails": [np.round(rail.T, 2).tolist() for rail in picture.rails],
            "tip": np.round(picture.tip, 2).tolist(),
            "lines": [
                [LINE_COLOURS[name], *np.round(line.T, 2).tolist()] for name, line in picture.lines
            ],
        }
        for picture in frame.pictures
    ]  # fmt: skip
    words = {
        "pictures": [*pictures, None, None][:2],
        "colour": _COLOURS.get(frame.mode, _INK),
        "dash": _DASHES.get(frame.mode, "solid"),
        "paths": frame.paths,
    }
    return words, [picture.grey for picture in frame.pictures[:2] if picture is not None]


def _plot(x: Any, y: Any, x_label: str | None, y_label: str | None, **more: Any) -> Any:
    """Return an empty figure over two ranges, in the style of the page."""
    plot = figure(x_range=x, y_range=y, tools="", toolbar_location=None, min_border=0,
                  sizing_mode="stretch_both", **more)  # fmt: skip
    plot.min_border_left, plot.min_border_right = 62, 8
    plot.min_border_top = plot.min_border_bottom = 6  # half of a tick label
    plot.background_fill_color, plot.border_fill_color = _PLOT, _GROUND
    plot.outline_line_color = _GRID
    plot.grid.grid_line_color = _GRID
    plot.xaxis.axis_label, plot.yaxis.axis_label = x_label, y_label
    for axis in plot.axis:
        axis.axis_line_color = axis.major_tick_line_color = _GRID
        axis.minor_tick_line_color = None
        axis.major_label_text_color = axis.axis_label_text_color = _INK
        axis.major_label_text_font_size = axis.axis_label_text_font_size = "11px"
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_standoff = 3
        axis.major_label_standoff = 3
    return plot


def _style_legend(plot: Any) -> None:
    legend = plot.legend[0]
    legend.location, legend.orientation = "top_left", "horizontal"
    legend.background_fill_alpha, legend.border_line_color = 0.6, None
    legend.background_fill_color, legend.label_text_color = _PLOT, _INK
    legend.label_text_font_size = "11px"
    legend.padding, legend.margin, legend.spacing, legend.glyph_width = 1, 2, 8, 16
    legend.label_height = legend.glyph_height = 10
