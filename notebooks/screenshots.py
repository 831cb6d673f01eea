"""The screens of the README, from a real browser: `make pictures`."""

import shutil
from contextlib import closing
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from sonoservo.diagrams import load_scenario, run
from sonoservo.systems.display.monitor import Monitor

HERE = Path(__file__).parent


def picture_monitor(browser: Browser) -> None:
    """The scanner's monitor when the needle of fig. 5 is centred."""
    with closing(Monitor()) as monitor:
        run(load_scenario("chatelain2013_fig5", changes=["duration=14"]), monitor=monitor)
        page = browser.new_page(viewport={"width": 1200, "height": 750})
        page.goto(monitor.web_url)
        page.wait_for_timeout(5000)
        page.screenshot(path=HERE / "monitor.png")


def main() -> None:
    """Take them all."""
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    installed = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=installed, args=arguments)
        picture_monitor(browser)
        browser.close()


if __name__ == "__main__":
    main()
