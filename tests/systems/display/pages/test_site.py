"""Pages of a site, and those who must not see them."""

import socket

import pytest
from page_clients.page_socket import open_socket
from page_clients.web_request import get
from tornado.websocket import WebSocketHandler

from sonoservo.systems.display import Site
from sonoservo.systems.display.pages.site import Access, Document, Guarded


class Echo(Guarded, WebSocketHandler):
    def check_origin(self, origin):
        return True

    async def on_message(self, message):
        await self.write_message(message, binary=True)


@pytest.fixture(scope="module")
def site():
    with Site() as site:
        site.add("page", "A <page>", [("", Document, {"text": "hello"}), ("socket", Echo, {})])
        yield site


def test_the_address_opens_a_page_and_leaves_a_cookie(site):
    status, headers, text = get(site.address("page"))
    assert (status, text) == (200, "hello")
    cookie = headers["Set-Cookie"]
    for each in (f"sonoservo_{site.port}=", "HttpOnly", "SameSite=Strict", "Path=/"):
        assert each in cookie
    bare = site.address("page").partition("?")[0]
    status, headers, text = get(bare, Cookie=cookie.partition(";")[0])
    assert (status, text) == (200, "hello")
    assert "Set-Cookie" not in headers
    assert headers["Content-Security-Policy"] == "frame-ancestors 'self'"
    for each in ("Cache-Control", "Cross-Origin-Resource-Policy", "Referrer-Policy"):
        assert headers[each] in ("no-store", "same-origin", "no-referrer")


def test_the_root_lists_the_pages(site):
    status, _, text = get(site.address())
    assert status == 200
    assert '<a href="page/">A &lt;page&gt;</a>' in text
    assert get(site.address("no-page"))[0] == 404


def test_without_the_token_a_page_says_where_its_address_stands(site):
    bare = site.address("page").partition("?")[0]
    for url in (bare, f"{bare}?token=", f"{bare}?token=x", bare.replace("page", "no-page")):
        status, headers, text = get(url, Cookie=f"sonoservo_{site.port}=guessed")
        assert status == 403
        assert "in its terminal" in text
        assert "It lacks the token of this run." in text
        assert site.access.token not in text + str(headers)


def test_pages_are_let_go_when_the_site_closes():
    with Site(port=23456) as site:  # no other test takes this port
        site.add("page", "Page", [("socket", Echo, {})])
        connection = open_socket(site.address("page"), "socket")
    with connection, pytest.raises(ConnectionRefusedError):
        socket.create_connection(("localhost", site.port), timeout=5)


def test_a_busy_port_is_stepped_over_and_what_is_wrong_with_a_host_or_a_port_is_said(site):
    with Site(port=site.port) as second:
        assert second.port > site.port
    with pytest.raises(ValueError, match="page: 'page' is not allowed"):
        site.add("page", "Another page", [])
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 65535))
        busy.listen()
        with pytest.raises(OSError, match="port: none of 65535 to 65535 is free on 'localhost'"):
            Site(port=65535)
    with pytest.raises(ValueError, match="host: '' is not allowed"):
        Site(host="")
    with pytest.raises(ValueError, match="port: 0 is not allowed; it must be 1 to 65535"):
        Site(port=0)
    with pytest.raises(OSError, match=r"host: '192\.0\.2\.7' is no name or address of this machi"):
        Site(host="192.0.2.7")


def asks(host, origin=None, tokens=("secret",), websocket=False, at="localhost"):
    return Access(at, token="secret").refusal(host, origin, tokens, websocket=websocket)


@pytest.mark.parametrize(
    ("at", "name", "own", "others"),
    [
        (
            "localhost",
            "localhost",
            ["localhost:7000", "127.0.0.1:7001", "[::1]:7000", "LOCALHOST"],
            [None, "localhost.evil", "192.0.2.7:7000", "localhost:x", "localhost@evil.example"],
        ),
        (
            "*",
            "Theatre3",
            ["192.0.2.7:7000", "[2001:db8::7]:7000", "theatre3:7000", "localhost:7000"],
            ["evil.example", "theatre3.evil.example", "192.0.2.7.evil.example", "", "*"],
        ),
        ("Theatre3.local", "Theatre3.local", ["theatre3.local:7000"], ["theatre3:7000"]),
        ("fe80::1", "[fe80::1]", ["[fe80::1]:7000"], ["[fe80::2]:7000"]),
    ],
)
def test_a_server_answers_to_its_own_names_at_any_port(monkeypatch, at, name, own, others):
    monkeypatch.setattr("sonoservo.systems.display.pages.site.gethostname", lambda: "Theatre3")
    assert Access(at).public_name == name
    for host in own:
        assert asks(host, at=at) is None
        assert asks(host, f"http://{host}", websocket=True, at=at) is None
    for host in others:
        assert "does not name this server" in asks(host, at=at)


@pytest.mark.parametrize(
    "origin",
    ["null", "http://localhost:9999", "http://localhost:7000.evil.example"],
)
def test_pages_of_other_origins_are_refused(origin):
    assert "another page" in asks("localhost:7000", None, websocket=True)  # it must name one
    for websocket in (False, True):
        assert "another page" in asks("localhost:7000", origin, websocket=websocket)


def test_either_token_will_do_a_wrong_one_will_not_and_none_is_printed():
    assert asks("localhost:7000", tokens=("", "secret")) is None
    for tokens in ((), ("",), ("secre",), ("secret2", "ä")):
        assert "token" in asks("localhost:7000", tokens=tokens)
    assert "secret" not in repr(Access(token="secret"))
    assert Access().token == Access("*").token
    assert len(Access().token) >= 32
