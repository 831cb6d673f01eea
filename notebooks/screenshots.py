"""Screenshots for the README and the documentation, taken in a browser by `make pictures`."""

import shutil
import sys
from argparse import ArgumentParser
from pathlib import Path

from playwright.sync_api import Browser, Error, sync_playwright

from sonoservo.diagrams import load_scenario, run
from sonoservo.systems.display.console.console import Console
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site

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


def main() -> None:
    """Take a screenshot of the console once the needle of fig. 5 is centred."""
    with sync_playwright() as playwright, Site() as site:
        browser = launch(playwright)
        meshcat = open_meshcat(site)
        scenario = load_scenario("chatelain2013_fig5", changes=["duration=24"])
        title = f"{scenario.name}, seed {scenario.seed}"
        console = Console(site, title=title, world="world")
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(console.web_url)
        page.wait_for_selector("body[data-ready]", state="attached")
        run(scenario, meshcat=meshcat, console=console)
        console.say(pace="")  # it tells more about the machine than about the run
        page.wait_for_timeout(5000)
        path = HERE / "console.png"
        page.screenshot(path=path)
        print(f"written: {path}")
        browser.close()


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
