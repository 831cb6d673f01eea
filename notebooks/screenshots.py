"""Screenshots for the README, taken in a browser by `make pictures`."""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Browser, Error, Page, sync_playwright

from sonoservo.diagrams import load_scenario, run
from sonoservo.systems.display.monitor import Monitor
from sonoservo.systems.display.pages import Site, open_meshcat

HERE = Path(__file__).parent
NO_CHROMIUM = "no Chromium: install it with your package manager, or `playwright install chromium`"


def launch(playwright) -> Browser:
    """Start a headless Chromium that draws WebGL without a graphics processor."""
    installed = shutil.which("chromium") or shutil.which("chromium-browser")
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    try:
        return playwright.chromium.launch(executable_path=installed, args=arguments)
    except Error:
        if installed:
            raise
        sys.exit(NO_CHROMIUM)


def picture(page: Page, url: str, path: Path) -> None:
    """Take a screenshot of a page after it has drawn everything."""
    page.goto(url)
    page.wait_for_timeout(5000)
    page.screenshot(path=path)
    print(f"written: {path}")


def main() -> None:
    """Take all screenshots once the needle of fig. 5 is centred."""
    with sync_playwright() as playwright, Site() as site:
        browser = launch(playwright)
        meshcat, monitor = open_meshcat(site), Monitor(site)
        scenario = load_scenario("chatelain2013_fig5", changes=["duration=14"])
        run(scenario, meshcat=meshcat, monitor=monitor)
        for url, name in ((meshcat.web_url(), "world.png"), (monitor.web_url, "monitor.png")):
            page = browser.new_page(viewport={"width": 1200, "height": 750})
            picture(page, url, HERE / name)
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
