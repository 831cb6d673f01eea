"""Document of one page of the console: two slices, the strips, and the link to its controls."""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from bokeh.document import Document
from bokeh.models import (
    ColumnDataSource,
    CustomJS,
    FactorRange,
    LinearColorMapper,
    Range1d,
)
from bokeh.palettes import Greys256
from bokeh.plotting import figure

from sonoservo.systems.display.colours import (
    FORCE,
    MODE_COLOURS,
    SECTOR,
    STEEL,
    STOPPED,
    UNCERTAINTY,
    hexadecimal,
)
from sonoservo.systems.display.console.history import STRIPS, Frame

_GROUND, _PLOT, _INK, _GRID = "#10141a", "#0a0d11", "#aeb7c2", "#242c36"
_FIRST, _SECOND = "#58b4f0", "#f0a35e"
_MODES = [str(mode) for mode in MODE_COLOURS]
_COLOURS = {str(mode): hexadecimal(colour) for mode, colour in MODE_COLOURS.items()}
_PAGE_COLOURS = {
    **{str(mode): colour for mode, colour in MODE_COLOURS.items()},
    "stopped": STOPPED, "steel": STEEL, "sector": SECTOR, "uncertainty": UNCERTAINTY,
    "force": FORCE,
}  # fmt: skip
_DASHES = {"tracking": "solid", "coasting": "dashed", "lost": "dotted"}
_LINK: Mapping[str, Any] = {"state": {}, "described": {}, "order": {}, "drawn": -1}
_LONGEST = 0.5
"""Longest time before a sample for which its mode is drawn, in s."""

_RING = 2.5
"""Radius of the ring at the tip, in mm."""

_LINES: Sequence[tuple[str, str, Sequence[tuple[str, str, str]], float]] = (
    ("features", "X, Z (mm)", (("x", _FIRST, "X"), ("z", _SECOND, "Z")), 2.0),
    ("angle", "Theta (°)", (("theta", _FIRST, ""),), 4.0),
    ("force", "force (N)", (("force", _FIRST, "force"), ("target", _SECOND, "target")), 1.0),
    ("error", "error (mm)", (("error", _FIRST, ""),), 0.5),
)
"""Name, axis, lines (column, colour and label) and smallest range of each strip."""

_SCRIPTS = ("console.js", "controls.js", "views.js")
"""Scripts of the page, which share one scope."""


class Link:
    """Link between a page and the console: values that either side sets and the other sees.

    `state` and `described` go to the page, `order` comes from it, and `drawn` is the number of the
    last state that it has drawn. Each is carried by a model that draws nothing, as its tag.
    """

    def __init__(self) -> None:
        self.models = {name: ColumnDataSource(tags=[value]) for name, value in _LINK.items()}

    def get(self, name: str) -> Any:
        """Return a value; None if the page has sent nothing of the kind."""
        tags = self.models[name].tags
        return tags[0] if tags and isinstance(tags[0], type(_LINK[name])) else None

    def set(self, name: str, value: Any) -> None:
        """Set a value."""
        self.models[name].tags = [value]

    def on_change(self, name: str, callback: Callable[[], None]) -> None:
        """Call a function whenever the page has set a value."""
        self.models[name].on_change("tags", lambda attribute, old, new: callback())


class PageDocument:
    """Models of one page.

    Parameters
    ----------
    document
        Document to fill.
    title
        Title of the page.
    """

    def __init__(self, document: Document, title: str) -> None:
        self.document = document
        self.link = Link()
        self._images = [_image_source() for _ in range(2)]
        self._marks = [_mark_source() for _ in range(2)]
        self._strips = ColumnDataSource({name: [] for name in (*STRIPS, "colour", "begin")})
        self._time: float | None = None
        grey = LinearColorMapper(palette=Greys256, low=0, high=255, name="grey")
        self._rings = [ColumnDataSource({"x": [], "y": []}) for _ in range(2)]
        self._rails: list[Any] = []
        self._axes: list[tuple[Any, Any]] = []
        roots = {
            f"slice_{number}": self._slice_figure(number, grey) for number in range(2)
        } | self._strip_figures()
        # They belong to the document, and follow its changes, only if one of its roots names them.
        roots["mode"].tags = list(self.link.models.values())
        with document.models.freeze():
            for name, root in roots.items():
                root.name = name
                document.add_root(root)
        document.title = title
        document.template = page_template()
        document.config.reconnect_session = False
        document.config.notify_connection_status = False
        start = CustomJS(
            args={"link": self.link.models, "grey": grey, "figures": roots},
            code="window.sonoservo.start(link, grey, figures)",
        )
        document.js_on_event("document_ready", start)

    def show_frame(self, frame: Frame) -> None:
        """Show the pictures of a volume, with the needle beside its echo."""
        colour = _COLOURS.get(frame.mode, _INK)
        for number in range(2):
            picture = frame.pictures[number] if number < len(frame.pictures) else None
            if picture is None:
                for source in (self._images[number], self._marks[number], self._rings[number]):
                    source.data = {name: [] for name in source.data}
                continue
            (x, y), (width, height) = picture.corner, picture.size
            self._images[number].data = {
                "image": [picture.grey], "x": [x], "y": [y], "dw": [width], "dh": [height],
            }  # fmt: skip
            for axis, label in zip(self._axes[number], picture.axes, strict=True):
                axis.axis_label = f"{label} (mm)"
            xs = [rail[:, 0].tolist() for rail in picture.rails]
            ys = [rail[:, 1].tolist() for rail in picture.rails]
            tip = [[value] for value in picture.tip.tolist()] or [[], []]
            self._marks[number].data = {"xs": xs, "ys": ys}
            rails, ring = self._rails[number]
            self._rings[number].data = {"x": tip[0], "y": tip[1]}
            for glyph in (rails.glyph, ring.glyph):
                glyph.line_color = colour
                glyph.line_dash = _DASHES.get(frame.mode, "solid")

    def show_strips(self, columns: Mapping[str, list[Any]], *, anew: bool, keep: int) -> None:
        """Add samples to the strips, or replace them.

        Parameters
        ----------
        columns
            New values by column.
        anew
            Whether they replace those before.
        keep
            Number of samples to keep.
        """
        data = dict(columns)
        data["colour"] = [_COLOURS.get(str(mode), _INK) for mode in data["mode"]]
        begins = [self._time if not anew else None, *data["time"]]
        if data["time"]:
            self._time = data["time"][-1]
        data["begin"] = [
            time - _LONGEST if begin is None else max(begin, time - _LONGEST)
            for begin, time in zip(begins, data["time"], strict=False)
        ]
        if anew:
            self._strips.data = data
        elif data["time"]:
            self._strips.stream(data, rollover=max(keep, 1))

    def _slice_figure(self, number: int, grey: LinearColorMapper) -> Any:
        plot = figure(
            x_range=Range1d(-50, 50, syncable=False),
            y_range=Range1d(80, 0, syncable=False),
            tools="", toolbar_location=None, sizing_mode="stretch_both", min_border=0,
        )  # fmt: skip
        _style(plot)
        plot.background_fill_color = "#000000"
        plot.grid.visible = False
        self._axes.append((plot.xaxis[0], plot.yaxis[0]))
        plot.image(source=self._images[number], color_mapper=grey)
        rails = plot.multi_line(
            "xs", "ys", source=self._marks[number], line_width=2, name=f"rails_{number}"
        )
        ring = plot.circle(
            "x", "y", radius=_RING, source=self._rings[number],
            fill_color=None, line_width=2, name=f"ring_{number}",
        )  # fmt: skip
        self._rails.append((rails, ring))
        return plot

    def _strip_figures(self) -> dict[str, Any]:
        time = Range1d(0, 10, name="time", syncable=False)
        plots = {}
        for name, label, lines, least in _LINES:
            plot = figure(
                x_range=time, y_range=Range1d(-0.5 * least, 0.5 * least, syncable=False),
                tools="", toolbar_location=None, sizing_mode="stretch_both", min_border=0,
                tags=[least],
            )  # fmt: skip
            _style(plot)
            for column, colour, text in lines:
                plot.line(
                    "time", column, source=self._strips, line_color=colour, line_width=1.6,
                    line_dash="dashed" if column in ("z", "target") else "solid",
                    **({"legend_label": text} if text else {}),
                )  # fmt: skip
            if any(text for *_, text in lines):
                _style_legend(plot)
            plot.yaxis.axis_label = label
            plot.xaxis.visible = False
            plots[name] = plot
        modes = figure(
            x_range=time, y_range=FactorRange(*reversed(_MODES)), tools="", toolbar_location=None,
            sizing_mode="stretch_both", min_border=0,
        )  # fmt: skip
        _style(modes)
        modes.ygrid.visible = False
        modes.hbar(left="begin", right="time", y="mode", source=self._strips, height=0.7,
                   fill_color="colour", line_color="colour")  # fmt: skip
        modes.xaxis.axis_label = "time (s)"
        plots["mode"] = modes
        for plot in plots.values():
            plot.min_border_left = 62
            plot.min_border_right = 8
        return plots


def page_template() -> str:
    """Return the template of the page, with its style and its script."""
    folder = files("sonoservo.systems.display.console")
    text = (folder / "console.html").read_text()
    colours = "".join(f"--{name}: {hexadecimal(each)}; " for name, each in _PAGE_COLOURS.items())
    text = text.replace("/* colours */", f":root {{ {colours}}}")
    scripts = "\n".join((folder / name).read_text() for name in _SCRIPTS)
    text = text.replace("/* console.css */", (folder / "console.css").read_text())
    return text.replace("/* scripts */", scripts)


def _image_source() -> ColumnDataSource:
    return ColumnDataSource({name: [] for name in ("image", "x", "y", "dw", "dh")})


def _mark_source() -> ColumnDataSource:
    return ColumnDataSource({"xs": [], "ys": []})


def _style(plot: Any) -> None:
    plot.background_fill_color, plot.border_fill_color = _PLOT, _GROUND
    plot.outline_line_color = _GRID
    plot.grid.grid_line_color = _GRID
    for axis in plot.axis:
        axis.axis_line_color = axis.major_tick_line_color = _GRID
        axis.minor_tick_line_color = None
        axis.major_label_text_color = axis.axis_label_text_color = _INK
        axis.major_label_text_font_size = axis.axis_label_text_font_size = "11px"
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_standoff = 3
        axis.major_label_standoff = 3


def _style_legend(plot: Any) -> None:
    legend = plot.legend[0]
    legend.location, legend.orientation = "top_left", "horizontal"
    legend.background_fill_alpha, legend.border_line_color = 0.6, None
    legend.background_fill_color, legend.label_text_color = _PLOT, _INK
    legend.label_text_font_size = "11px"
    legend.padding, legend.margin, legend.spacing, legend.glyph_width = 1, 2, 8, 16
    legend.label_height = legend.glyph_height = 10
