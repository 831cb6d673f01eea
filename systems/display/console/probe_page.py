"""Page of a site with the view of the probe."""

import gc
from collections.abc import Callable
from importlib.resources import files

from meshcat import Visualizer

from sonoservo.systems.display.console.probe_view import ProbeView
from sonoservo.systems.display.console.scene_page import ScenePage
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume


class ProbePage:
    """Shows volumes in the probe frame, for pages that have drawn what they were sent.

    `asked` is called on the site's thread when a page is ready for the newest volume.
    """

    def __init__(self, site: Site, asked: Callable[[], None]) -> None:
        page = (files("sonoservo.systems.display.console") / "probe_page.html").read_text()
        self._page = ScenePage(site, name="probe", title="Probe", page=page, asked=asked)
        self._view = ProbeView(Visualizer(window=self._page))
        self._drawn: Volume | None = None

    def show(self, volume: Volume, estimate: NeedleEstimate | None) -> None:
        """Draw a volume if a page wants it. Call this on the site's thread only."""
        if volume is self._drawn or not self._page.wanted:
            return
        self._drawn = volume
        # Drake aborts if a Meshcat is destroyed on a thread other than its own, so garbage must not
        # be collected on this thread.
        collects = gc.isenabled()
        gc.disable()
        try:
            self._view.draw(volume, estimate)
        finally:
            if collects:
                gc.enable()
