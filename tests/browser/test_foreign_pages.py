"""Pages of other origins in the same browser, which neither see a run nor steer it."""

from urllib.parse import urlsplit

import pytest
from page_clients.console_socket import session_token

from sonoservo.systems.display.console.console import Console
from sonoservo.systems.display.pages.site import Site

_TRY = """
async url => {
  const opens = address => new Promise(resolve => {
    const socket = new WebSocket(address);
    socket.onopen = () => resolve(true);
    socket.onerror = () => resolve(false);
  });
  const reads = (address, options) => fetch(address, options).then(
    async answer => answer.ok && (await answer.text()).length > 0, () => false);
  const runs = address => new Promise(resolve => {
    const script = document.createElement("script");
    script.onload = () => resolve(true);
    script.onerror = () => resolve(false);
    script.src = address;
    document.head.append(script);
  });
  const bare = url.split("?")[0];
  const results = [];
  for (const address of [bare, url])
    results.push(
      await opens(address.replace("http", "ws")),
      await reads(address, {credentials: "include"}),
      await reads(address, {mode: "no-cors", credentials: "include"}),
      await runs(address),
    );
  return results;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("origin", ["http://evil.example", "http://localhost:9999"])
def test_a_foreign_page_is_refused_though_the_run_is_open_beside_it(meshcat, browser, origin):
    context = browser.new_context(viewport={"width": 100, "height": 100})
    context.route(f"{origin}/", lambda route: route.fulfill(body="<p>", content_type="text/html"))
    own = context.new_page()
    own.goto(meshcat.web_url())  # this browser has the cookie
    own.wait_for_function("connection.readyState == WebSocket.OPEN")
    foreign = context.new_page()
    foreign.goto(f"{origin}/")
    assert foreign.evaluate(_TRY, meshcat.web_url()) == 8 * [False]
    framed = foreign.evaluate(
        """async url => {
          const frame = document.createElement("iframe");
          const loaded = new Promise(resolve => frame.onload = resolve);
          frame.src = url;
          document.body.append(frame);
          await loaded;
        }""",
        meshcat.web_url().partition("?")[0],
    )
    assert framed is None
    assert all("Drake" not in (frame.title() or "") for frame in foreign.frames)
    assert meshcat.GetNumActiveConnections() == 1
    place = urlsplit(meshcat.web_url())
    own.goto(f"http://{place.netloc}/world/")  # the user's own page goes on by its cookie
    own.wait_for_function("connection.readyState == WebSocket.OPEN")
    context.close()


_TRY_CONSOLE = """
async ([url, token]) => {
  const bare = url.split("?")[0], results = [];
  for (const address of [bare + "ws", url.replace("?", "ws?")])
    results.push(await new Promise(resolve => {
      const socket = new WebSocket(address.replace("http", "ws"), ["bokeh", token]);
      socket.onopen = () => resolve(true);
      socket.onerror = () => resolve(false);
    }));
  for (const address of [bare, url, bare + "autoload.js", bare + "metadata"])
    results.push(await fetch(address, {credentials: "include"}).then(
      async answer => answer.ok && (await answer.text()).length > 0, () => false));
  return results;
}
"""


@pytest.mark.slow
def test_a_foreign_page_neither_reads_nor_steers_a_console(browser, open_page):
    with Site() as site:
        console = Console(site)
        console.controls.offer_buttons("stop")
        token = session_token(console.web_url)  # even if it had guessed it
        for origin in ("http://evil.example", "http://localhost:9999"):
            context = browser.new_context(viewport={"width": 100, "height": 100})
            context.route(
                f"{origin}/", lambda route: route.fulfill(body="<p>", content_type="text/html")
            )
            own = context.new_page()
            own.goto(console.web_url)  # this browser has the cookie
            own.wait_for_selector("body[data-ready]", state="attached")
            foreign = context.new_page()
            foreign.goto(f"{origin}/")
            assert foreign.evaluate(_TRY_CONSOLE, [console.web_url, token]) == 6 * [False]
            bare = console.web_url.partition("?")[0]
            own.goto(bare)  # the user's own page goes on by its cookie
            own.wait_for_selector("body[data-ready]", state="attached")
            context.close()
        assert console.controls.pressed() == set()
