import gc
import re
import shutil

import pytest
from playwright.sync_api import Error, expect, sync_playwright

PATIENCE = 60_000  # in ms; a busy machine draws slowly
expect.set_options(timeout=PATIENCE)
NO_CHROMIUM = "no Chromium: install it with your package manager, or `playwright install chromium`"
KNOWN_WARNINGS = (
    "GPU stall due to ReadPixels",
    "software rendering",
    "fallback software",
    # A page whose server has ended looks for the next one.
    "ERR_CONNECTION_REFUSED",
    # A picture that was replaced before a page that draws in software came to fetch it.
    "CAS key not found",
    "Couldn't load texture cas-v1",
    'Failed to load buffer "cas-v1',
)


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium that draws WebGL without a graphics chip.

    Playwright's loop runs in the thread of the tests as long as it is open, and keeps out the loops
    of other modules' clients.
    """
    installed = shutil.which("chromium") or shutil.which("chromium-browser")
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    with sync_playwright() as playwright:
        try:
            chromium = playwright.chromium.launch(executable_path=installed, args=arguments)
        except Error:
            if installed:
                raise
            pytest.skip(NO_CHROMIUM)
        yield chromium
        chromium.close()


@pytest.fixture(autouse=True)
def no_garbage():
    """Drake aborts where a Meshcat ends on another thread than its own, as in a monitor's."""
    yield
    gc.collect()


@pytest.fixture
def open_page(browser):
    """Open an address and wait until it shows something.

    At the end, anything on the console but known warnings fails the test, and so does a request
    that left this machine.
    """
    context = browser.new_context(viewport={"width": 1000, "height": 700})
    context.set_default_timeout(PATIENCE)
    complaints = []

    def listen(page):
        page.on("pageerror", shout)
        page.on("console", heed)

    def shout(error):
        # A page that is reloaded, or that is left, aborts what it was loading.
        if "Failed to load buffer" not in str(error):
            complaints.append(str(error))

    def heed(message):
        known = any(re.search(each, message.text) for each in KNOWN_WARNINGS)
        if message.type in ("warning", "error") and not known:
            complaints.append(f"{message.type}: {message.text}")

    def refuse_network(route):
        local = re.match(
            r"(http|ws)://(localhost|127\.0\.0\.1)[:/]|file:|data:|blob:", route.request.url
        )
        if local:
            route.continue_()
        else:
            complaints.append(f"asked for {route.request.url}")
            route.abort()

    context.route("**/*", refuse_network)

    def open_address(url):
        page = context.new_page()
        listen(page)
        page.goto(url)
        if "/console/" in url:
            page.wait_for_selector("body[data-ready]", state="attached")
        elif "/click/" in url:
            page.wait_for_selector("#picture image", state="attached")
        else:
            page.wait_for_function("typeof viewer !== 'undefined' && viewer.renderer")
        return page

    yield open_address
    context.close()
    assert not complaints
