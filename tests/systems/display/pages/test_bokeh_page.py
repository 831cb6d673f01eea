"""A Bokeh page behind a site: who gets in."""

import json
from contextlib import closing

import pytest
from page_clients.console_socket import open_console, session_token
from page_clients.page_socket import ask, read_frame, read_until_closed, send_frame
from page_clients.web_request import get

from sonoservo.systems.display import Site
from sonoservo.systems.display.pages.bokeh_page import open_bokeh_page


@pytest.fixture(scope="module")
def site():
    with Site() as site:
        open_bokeh_page(site, page="page", title="Page", make=lambda document: None)
        yield site


@pytest.mark.parametrize("path", ["", "ws", "autoload.js", "metadata", "no-such-file"])
def test_nothing_but_the_library_is_served_without_the_token(site, path):
    bare = site.address("page").partition("?")[0]
    assert get(bare + path)[0] == (404 if path == "no-such-file" else 403)
    assert get(f"{bare}{path}?token=guessed")[0] == (404 if path == "no-such-file" else 403)


def test_hostile_pages_do_not_reach_the_socket_even_with_all_tokens(site):
    url = site.address("page")
    session = {"Sec-WebSocket-Protocol": f"bokeh, {session_token(url)}"}
    assert "101" in ask(url, "ws", **session)[0]
    for headers in ({"Host": "evil.example:7000"}, {"Origin": "null"}, {"Origin": None}):
        refused = ask(url, "ws", **(session | headers))
        assert "403" in refused[0] or "400" in refused[0]
        assert site.access.token not in "".join(refused)
    assert "403" in ask(url.partition("?")[0], "ws", **session)[0]


def header(kind):
    return json.dumps({"msgid": "1", "msgtype": kind})


TORN = {
    "no JSON": ["junk"],
    "a list": ["[1]", "[]", "[]"],
    "numbers": ["1", "2", "3"],
    "of no known type": [header("LAUNCH"), "{}", "{}"],
    "an answer to nothing": [header("ACK"), "{}", "{}"],
    "nested lists": [header("PATCH-DOC"), "{}", "[" * 30_000],
    "nothing to change": [header("PATCH-DOC"), "{}", '{"events": [{"kind": "Nothing"}]}'],
    "a whole document": [header("PUSH-DOC"), "{}", '{"doc": {"roots": 1}}'],
}


@pytest.mark.parametrize("early", [True, False])
def test_a_torn_message_costs_its_page_at_most_and_leaves_no_traceback(site, early, caplog):
    url = site.address("page")
    for fragments in TORN.values():
        with closing(open_console(url)) as page:
            if not early:  # the server has sent its header, metadata and content
                for _ in range(3):
                    read_frame(page)
            for each in fragments:
                send_frame(page, each.encode(), kind=0x81)
            send_frame(page, b"", kind=0x88)
            read_until_closed(page)
    with closing(open_console(url)) as page:
        send_frame(page, b"\xff\xfe", kind=0x82)  # no text
        read_until_closed(page)
    assert get(url)[0] == 200
    assert caplog.text == ""
