"""The scanner's monitor: a separate web page, in the probe frame."""

import gc
from html import escape

from meshcat import Visualizer

from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.scene_page import ScenePage, read_page
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume


class Monitor:
    """Shows volumes, and the estimated needle in them, as a scanner does (Chatelain 2013, fig. 3).

    The two orthogonal planes through the needle stand one above the other, and a view beside them
    shows where they lie in the probe frame P. The monitor adds scales in mm, the volume's number
    and time, the tracking mode and the depth of the tip below the probe's face. It is shown in a
    web page, or in a notebook if it is the last value of a cell.

    A slow, closed or missing page never delays the caller. The newest volume is drawn on a thread
    of its own, and only once a page has drawn the previous picture.

    Parameters
    ----------
    site
        Site to which the page is added. By default, the monitor opens one of its own, and closes
        it.

    Raises
    ------
    OSError
        If no port is free for a site of its own.
    """

    def __init__(self, site: Site | None = None) -> None:
        self._newest: tuple[Volume, NeedleEstimate | None, int] | None = None
        self._drawn: object = None
        self._shown = 0
        self._owns_site = site is None
        self._site = site or Site()
        self._page = ScenePage(
            self._site,
            name="monitor",
            title="Scanner's monitor",
            page=read_page("monitor_page.html"),
            asked=self._draw,
        )
        self._screen: MonitorScreen | None = None

    @property
    def web_url(self) -> str:
        """Address of the monitor's page, with the token that opens it."""
        return self._site.address("monitor")

    def show(
        self, volume: Volume, estimate: NeedleEstimate | None = None, number: int | None = None
    ) -> None:
        """Show a volume soon, and return at once.

        Parameters
        ----------
        volume
            Volume to show.
        estimate
            Estimate of the needle in the volume, if a tracker has processed it.
        number
            Number of the volume; by default volumes are counted from 1.
        """
        self._shown = self._shown + 1 if number is None else number
        self._newest = volume, estimate, self._shown
        self._site.call(self._draw)

    def html(self) -> str:
        """Return the current page as one self-contained HTML document."""

        def document() -> str:
            self._draw(needed=True)
            return self._page.html()

        return self._site.ask(document)

    def close(self) -> None:
        """Disconnect the pages, which keep the last picture; close the monitor's own site."""
        if self._owns_site:
            self._site.close()
        else:
            self._site.call(self._page.disconnect)

    def _draw(self, needed: bool = False) -> None:
        newest = self._newest
        if newest is None or newest is self._drawn or not (needed or self._page.wanted):
            return
        self._drawn = newest
        if self._screen is None:
            self._screen = MonitorScreen(Visualizer(window=self._page))
        # Drake aborts if a Meshcat is destroyed on a thread other than its own, so garbage must not
        # be collected on this thread.
        collects = gc.isenabled()
        gc.disable()
        try:
            self._screen.draw(*newest)
        finally:
            if collects:
                gc.enable()

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.web_url)}" title="Scanner\'s monitor" '
            'style="width: 100%; aspect-ratio: 1.6; border: none"></iframe>'
        )
