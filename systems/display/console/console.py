"""The console: the one page on which a run, a drive or a recording is watched and controlled."""

import gc
import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any

from sonoservo.systems.display.console.controls import Controls, finite_number
from sonoservo.systems.display.console.probe_view import ProbeView
from sonoservo.systems.display.console.readings import (
    Cine,
    Frame,
    Sample,
    Strips,
    describe_state,
    needle_readings,
    sample_estimate,
)
from sonoservo.systems.display.console.slices import slice_pictures
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

Shown = tuple[Volume, NeedleEstimate | None, int, LineHypotheses | None]
"""Volume, the estimate in it, its number, and the lines that are followed."""

if TYPE_CHECKING:
    from bokeh.document import Document


_PERIOD = 0.2  # Shortest time between two updates of a page, in s
# Time in s after which a page that does not say what it has drawn is sent something again.
_PATIENCE = 10.0


class Console:
    """Shows volumes, the needle in them, strips over the last minute and the state in words.

    The two orthogonal planes through the needle stand beside a view of the world, or of the probe
    where no Meshcat of Drake's draws the world. Any number of pages may be open, including none.
    They share the `controls`. The console is shown in a web page, or in a notebook if it is the
    last value of a cell.

    A slow, closed or missing page never delays the caller. Pages are drawn on the site's thread,
    each only once it has drawn its previous picture, and nothing is drawn for nobody.

    Parameters
    ----------
    site
        Site to which the page is added. By default, the console opens one of its own, and closes
        it.
    title
        Title of the page.
    world
        Name of the site's page with the world, or path of a kept one such as report/replay.html;
        empty for a view of the probe, drawn here, and None for neither.

    Attributes
    ----------
    controls
        Sliders and buttons of the pages.

    Raises
    ------
    OSError
        If no port is free for a site of its own.
    """

    def __init__(
        self, site: Site | None = None, *, title: str = "sonoservo", world: str | None = ""
    ) -> None:
        from sonoservo.systems.display.pages.bokeh_page import open_bokeh_page

        self._owns_site, self._site = site is None, site or Site()
        self._title = title
        probe = world == ""
        self._facts: dict[str, Any] = {"title": title, "world": "probe" if probe else world or ""}
        self._newest: Shown | Frame | None = None
        self._shown = 0
        self._views: set[_View] = set()
        self.strips, self.cine = Strips(), Cine()
        self.controls = Controls(self._wake)
        self._probe = ProbeView(self._site) if probe else None
        self._probed: Volume | None = None
        open_bokeh_page(self._site, page="console", title="Console", make=self._open)

    @property
    def web_url(self) -> str:
        """Address of the console's page, with the token that opens it."""
        return self._site.address("console")

    def show(
        self,
        volume: Volume,
        estimate: NeedleEstimate | None = None,
        number: int | None = None,
        **values: float,
    ) -> None:
        """Show a volume and the readings of its estimate soon, and return at once.

        Volumes are counted from 1 unless a `number` is given; `values` are the tip's ``error`` in
        mm and the contact ``force`` in N, if known.
        """
        without = [name for name in ("force", "error", "inserted") if name not in values]
        self.say(without=[*without, *(("probability",) if estimate is None else ())])
        self.show_volume(volume, estimate, number)
        self.add(sample_estimate(volume.time, estimate, volume.X_WP, None, **values))

    def show_volume(
        self,
        volume: Volume,
        estimate: NeedleEstimate | None = None,
        number: int | None = None,
        lines: LineHypotheses | None = None,
    ) -> None:
        """Show the slices of a volume only, with the lines that are followed; see `show`."""
        self._shown = self._shown + 1 if number is None else number
        self._newest = volume, estimate, self._shown, lines
        self._wake()

    def show_frame(self, frame: Frame) -> None:
        """Show pictures that were taken earlier, beside which there is nothing to look at."""
        self._newest = frame
        self._wake()

    def add(self, sample: Sample) -> None:
        """Add a sample to the strips, and show its state."""
        self._site.call(lambda: self.strips.append(sample))
        self._wake()

    def say(self, **facts: Any) -> None:
        """Show facts about the run.

        They are ``paused``; ``pace``, ``note`` and ``ended`` in words; address of the ``report``;
        ``legend`` of the world; parts of the page that it goes ``without``: world, slices, the
        second one, planes, cine, strips, readings, and each of these by name; ``seek``, the time in
        s to which a recorded world is wound.
        """
        if any(self._facts.get(name) != value for name, value in facts.items()):
            self._facts = self._facts | facts
            self._wake()

    def end(self, words: str) -> None:
        """Say how the run has ended, and offer nothing more."""
        self.controls.offer([])
        self.controls.offer_buttons()
        self.say(ended=words, paused=False, pace="", note="")

    def wait_until_shown(self, longest: float) -> None:
        """Wait until all open pages show what was said, but no longer than a time in s."""
        end = clock.monotonic() + longest
        while not all(each.shows_all for each in tuple(self._views)) and clock.monotonic() < end:
            clock.sleep(0.02)

    def close(self) -> None:
        """Close the console's own site; the pages keep the last picture and say so."""
        if self._owns_site:
            self._site.close()

    @property
    def facts(self) -> Mapping[str, Any]:
        """What was said with `say`, and the title."""
        return self._facts

    def frame(self) -> Frame | None:
        """Return the pictures of the newest volume; call this on the site's thread only."""
        newest = self._newest
        if newest is None:
            return None
        if isinstance(newest, Frame):
            if self.cine.at(newest.time) is not newest:
                self.cine.append(newest)
            return newest
        volume, _, number, _ = newest
        last = self.cine.at(volume.time)
        if last is None or (last.number, last.time) != (number, volume.time):
            last = picture_volume(*newest)
            self.cine.append(last)
        return last

    def frame_beside(self, offsets: tuple[float, float]) -> Frame | None:
        """Return pictures of the newest volume beside the needle, at distances in m."""
        newest = self._newest
        if newest is None or isinstance(newest, Frame):
            return newest
        return picture_volume(*newest, offsets=offsets)

    def _open(self, document: "Document") -> None:
        view = _View(self, document)
        self._views.add(view)
        document.on_session_destroyed(lambda context: self._views.discard(view))
        self._wake()

    def _wake(self) -> None:
        self._site.call(self._update)

    def _update(self) -> None:
        if self._probe is not None and self._views and isinstance(self._newest, tuple):
            volume, estimate, *_ = self._newest
            if volume is not self._probed:
                self._probed = volume
                with collecting_nothing():
                    self._probe.show(volume, estimate)
        for view in self._views:
            view.wake()

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.web_url)}" title="{escape(self._title)}" '
            'style="width: 100%; aspect-ratio: 1.6; border: none"></iframe>'
        )


class _View:
    """One page of a console: what it was sent, and what it has asked for."""

    def __init__(self, console: Console, document: "Document") -> None:
        from sonoservo.systems.display.console.document import PageDocument

        self._console = console
        self._page = PageDocument(document, str(console.facts["title"]))
        self._sent, self._sent_at = -1, -_PATIENCE
        self._waits = False
        self._frame: Frame | None = None
        self._strips_end = -1
        self._offsets = (0.0, 0.0)
        self._cine: float | None = None
        self._heard = 0
        self._looked: object = None
        self._beside: Frame | None = None
        self._described: dict[str, Any] = {}
        self._state_sent: dict[str, Any] = {}
        page = self._page
        page.on_change("order", lambda: self._obey(page.heard("order") or {}))
        page.on_change("drawn", self.wake)
        document.on_session_destroyed(lambda context: console.controls.deflect(self, None))
        self._push()

    @property
    def shows_all(self) -> bool:
        """Whether the page has drawn everything that the console says."""
        said = self._console.facts.items()
        sent = all(self._state_sent.get(name) == value for name, value in said)
        return sent and (self._page.heard("drawn") or 0) >= self._sent

    def wake(self) -> None:
        """Update the page soon, if it has drawn what it was sent."""
        if self._waits:
            return
        self._waits = True
        late = self._sent_at + _PERIOD - clock.monotonic()
        document = self._page.document
        if late > 0:
            document.add_timeout_callback(self._go_on, round(1e3 * late) + 1)
        else:
            document.add_next_tick_callback(self._go_on)

    def _go_on(self) -> None:
        self._waits = False
        silent = clock.monotonic() - self._sent_at
        drawn = self._page.heard("drawn")
        if (drawn is None or drawn < self._sent) and silent < _PATIENCE:
            return  # it says when it is ready
        if drawn is None or drawn < 0:  # it may have opened late, and missed what it was sent
            self._frame, self._strips_end, self._state_sent = None, -1, {}
        self._push()

    def _push(self) -> None:
        with collecting_nothing():
            self._send()

    def _send(self) -> None:
        console, page = self._console, self._page
        newest = console.frame()
        frame = newest
        if self._cine is not None:
            frame = console.cine.at(self._cine)
        elif any(self._offsets):
            key = newest, self._offsets
            if key != self._looked:
                self._beside, self._looked = console.frame_beside(self._offsets), key
            frame = self._beside
        strips = console.strips
        anew = self._strips_end < strips.begin
        begin = strips.begin if anew else self._strips_end
        described = dict(console.controls.description())
        if described != self._described:
            self._described = described
            page.send("described", described)
        state = self._state(frame)
        changes = strips.end != self._strips_end
        if state == self._state_sent and frame is self._frame and not changes:
            return
        self._sent, self._sent_at = self._sent + 1, clock.monotonic()
        page.show(
            state | {"number": self._sent},
            frame=frame if frame is not self._frame else None,
            strips=strips.columns(begin) if changes else None,
            anew=anew,
            keep=max(strips.end - strips.begin, 1),
        )
        self._state_sent, self._frame, self._strips_end = state, frame, strips.end

    def _state(self, frame: Frame | None) -> dict[str, Any]:
        console = self._console
        sample = console.strips.newest
        controls, values, _ = console.controls.shown
        operated = any(each.port == "needle_target" for each in controls)
        state: dict[str, Any] = {**console.facts, **describe_state(sample, operated=operated)}
        state["values"], state["speed"] = values, console.controls.speed
        if sample is not None:
            state |= {"time": sample.time, "held": sample.held, "lines": dict(sample.lines)}
            state["readings"] = [each.shown() for each in needle_readings(sample)]
        times = console.cine.times
        state["cine"] = [times[0], times[-1]] if times else None
        state["live"] = self._cine is None
        if frame is not None:
            state |= {
                "volume": frame.number,
                "volume_time": frame.time,
                "decibels_per_level": frame.decibels_per_level,
            }
        state["heard"] = self._heard
        state["offsets"] = [round(1e3 * each, 1) for each in self._offsets]
        return state

    def _obey(self, order: Mapping[str, Any]) -> None:
        """Carry out what the page asks for; whatever is malformed is ignored."""
        controls = self._console.controls
        self._heard = int(finite_number(order.get("order")) or 0)
        if isinstance(button := order.get("press"), str):
            controls.press(button)
        if isinstance(name := order.get("set"), str):
            controls.move(name, order.get("value"))
        if "speed" in order:
            controls.set_speed(order["speed"])
        if "axes" in order:
            controls.deflect(self, order["axes"])
        if "cine" in order:
            self._cine = finite_number(order["cine"])
        if isinstance(asked := order.get("offsets"), list) and len(asked) == 2:
            first, second = (min(max(finite_number(each) or 0.0, -200.0), 200.0) for each in asked)
            self._offsets = 1e-3 * first, 1e-3 * second
        self.wake()


@contextmanager
def collecting_nothing() -> Iterator[None]:
    """Keep garbage: Drake aborts if a Meshcat of another thread is destroyed on the site's."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def picture_volume(
    volume: Volume,
    estimate: NeedleEstimate | None,
    number: int,
    lines: LineHypotheses | None = None,
    offsets: tuple[float, float] = (0.0, 0.0),
) -> Frame:
    """Return the pictures of a volume; see `slice_pictures` for the offsets."""
    curve = estimate.curve if estimate is not None else None
    pictures = slice_pictures(volume, curve, offsets, lines)
    mode = str(estimate.mode) if estimate is not None else ""
    return Frame(number, volume.time, mode, pictures, volume.decibels_per_level)
