"""The scanner's monitor: a web page of its own, in the probe frame."""

import gc
from html import escape

from meshcat import Visualizer

from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.page_server import PageServer, read_page
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

PORT = 7600
"""Where a monitor is looked for first."""


class Monitor:
    """Shows volumes, and the estimated needle in them, as a scanner does (Chatelain 2013, fig. 3).

    The two orthogonal planes through the needle stand one above the other, and beside them where
    they are in the probe frame P; with scales in mm, the volume's number and time, what the tracker
    is doing, and how deep the tip is below the probe's face. A web page shows it, or a notebook in
    which it is the last value of a cell.

    A page that is slow, closed or not there never holds up whoever shows a volume: a picture of the
    newest one is drawn on a thread of its own when a page has drawn the last, and not before.

    Parameters
    ----------
    host
        Name or address to listen on.
    port
        To listen on; the next free one where it is in use.

    Raises
    ------
    OSError
        If nothing can listen there.
    """

    def __init__(self, *, host: str = "localhost", port: int = PORT) -> None:
        self._newest: tuple[Volume, NeedleEstimate | None, int] | None = None
        self._drawn: object = None
        self._shown = 0
        page = read_page("monitor_page.html")
        self._server = PageServer(page=page, host=host, port=port, asked=self._draw)
        self._screen: MonitorScreen | None = None

    @property
    def web_url(self) -> str:
        """Where it is to be seen."""
        return self._server.web_url

    def show(
        self, volume: Volume, estimate: NeedleEstimate | None = None, number: int | None = None
    ) -> None:
        """Show a volume soon, and return at once.

        Parameters
        ----------
        volume
            To show.
        estimate
            Of the needle in it, if a tracker has seen it.
        number
            Of the volume; by default they are counted from 1.
        """
        self._shown = self._shown + 1 if number is None else number
        self._newest = volume, estimate, self._shown
        self._server.call(self._draw)

    def html(self) -> str:
        """Return what it shows as one document, to keep or to send on."""

        def document() -> str:
            self._draw(needed=True)
            return self._server.html()

        return self._server.ask(document)

    def close(self) -> None:
        """Stop serving; open pages keep the last picture, and say so."""
        self._server.close()

    def _draw(self, needed: bool = False) -> None:
        newest = self._newest
        if newest is None or newest is self._drawn or not (needed or self._server.wanted):
            return
        self._drawn = newest
        if self._screen is None:
            self._screen = MonitorScreen(Visualizer(window=self._server))
        # Drake aborts where a Meshcat ends on another thread than its own: none is to be found here
        # and collected as garbage.
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
