"""The scanner's monitor: a separate web page, in the probe frame."""

import gc
from html import escape

from meshcat import Visualizer

from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.page_server import PageServer, read_page
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

PORT = 7600
"""Port that a monitor tries first."""


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
    host
        Name or address to listen on.
    port
        Port to listen on, or the next free one if it is in use.

    Raises
    ------
    OSError
        If the host is not an address of this machine, or no port is free.
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
        """Address of the monitor's page."""
        return self._server.web_url

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
        self._server.call(self._draw)

    def html(self) -> str:
        """Return the current page as one self-contained HTML document."""

        def document() -> str:
            self._draw(needed=True)
            return self._server.html()

        return self._server.ask(document)

    def close(self) -> None:
        """Stop serving; open pages keep the last picture and say that they are not connected."""
        self._server.close()

    def _draw(self, needed: bool = False) -> None:
        newest = self._newest
        if newest is None or newest is self._drawn or not (needed or self._server.wanted):
            return
        self._drawn = newest
        if self._screen is None:
            self._screen = MonitorScreen(Visualizer(window=self._server))
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
