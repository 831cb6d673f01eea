"""The pages of a command: the site, the console and the world on it."""

import os
import sys
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydrake.geometry import Meshcat
from rich.console import Console as Terminal
from rich.text import Text

from sonoservo.diagrams.app.interruption import is_interrupted
from sonoservo.diagrams.app.options import Page
from sonoservo.systems.display.console.console import Console
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Files, Site
from sonoservo.systems.files.refusals import ConfigurationError

_REPLAY = "replay.html"

_LONGEST = 5.0  # time in s for which a program waits at its end for its page


@dataclass(frozen=True, kw_only=True)
class Pages:
    """Site of a command, its console, and the Meshcat that draws the world, if Drake's does."""

    page: Page
    site: Site
    console: Console
    meshcat: Meshcat | None = None

    def announce(self, terminal: Terminal) -> None:
        """Print the console's address, and open it for a person at a terminal of this desktop."""
        announce(terminal, "Watch at", self.console.web_url, self.page)

    def end(self, terminal: Terminal, said: str, report: Path | None = None) -> None:
        """Say in the page that the run has ended, link its report, and serve the files beside it.

        If a person sits at the terminal, wait until they press Enter, so that the page stays
        usable. If not, wait until it shows the end.
        """
        if report is not None:
            _serve_results(self.site, self.console, report)
        stays = terminal.is_interactive and sys.stdin.isatty() and not is_interrupted()
        if report is not None and report.is_file() and not stays:
            said += f" Report: {report}"  # the link will soon lead nowhere
        self.console.end(said)
        if stays:
            terminal.print("The page stays open: press Enter to end.")
            with suppress(EOFError, KeyboardInterrupt):
                input()
        elif not is_interrupted():
            self.console.wait_until_shown(_LONGEST)


def open_pages(
    title: str,
    page: Page | None = None,
    *,
    world: bool = True,
    kept: Path | None = None,
) -> Pages:
    """Open the pages of a command on the first free port from 7000 on.

    Without a ``world``, the console draws a view of the probe; a folder ``kept`` has the
    replay.html that takes the world's place. ConfigurationError if it cannot listen there.
    """
    page = page or Page()
    site = open_site(page)
    meshcat = open_meshcat(site) if world and kept is None else None
    shown: str | None = "world" if world else ""
    if kept is not None:
        shown = f"report/{_REPLAY}" if (kept / _REPLAY).is_file() else None
    console = Console(site, title=title, world=shown)
    if kept is not None:
        _serve_results(site, console, kept / "report.html")
    return Pages(page=page, site=site, console=console, meshcat=meshcat)


def open_site(page: Page) -> Site:
    """Open a site on the first free port from 7000 on."""
    try:
        return Site(host=page.host)
    except OSError as error:
        raise ConfigurationError(str(error)) from error


def announce(terminal: Terminal, words: str, address: str, page: Page) -> None:
    """Print the address of a page, and open it for a person at a terminal of this desktop."""
    terminal.print(words, Text(address, style="bold"), soft_wrap=True)
    if page.open_page and terminal.is_interactive and has_desktop():
        webbrowser.open(address)


def _serve_results(site: Site, console: Console, report: Path) -> None:
    """Serve the folder of a run's report, and link the report in the console, if there is one."""
    site.add("report", "Report", [("(.*)", Files, {"path": str(report.parent.absolute())})])
    if report.is_file():
        console.say(report=f"../report/{report.name}")


def has_desktop() -> bool:
    """Return True if a browser that is opened here appears before the user."""
    if os.environ.get("SSH_CONNECTION"):
        return False
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
