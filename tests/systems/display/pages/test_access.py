import pytest

from sonoservo.systems.display.pages.site import Access

HERE = Access(token="secret")
EVERYWHERE = Access("*", token="secret")


def asks(access, host, origin=None, tokens=("secret",), websocket=False):
    return access.refusal(host, origin, tokens, websocket=websocket)


@pytest.mark.parametrize("host", ["localhost:7000", "127.0.0.1:7001", "[::1]:7000", "LOCALHOST"])
def test_its_own_names_are_answered_at_any_port(host):
    assert asks(HERE, host) is None
    assert asks(HERE, host, f"http://{host}", websocket=True) is None


@pytest.mark.parametrize(
    "host",
    [None, "", "evil.example:7000", "localhost.evil.example", "192.0.2.7:7000", "127.0.0.2:7000",
     "localhost:x", "localhost:99999", "[::1", "localhost@evil.example", "0.0.0.0:7000"],
)  # fmt: skip
def test_other_names_are_refused(host):
    assert "does not name this server" in asks(HERE, host)


def test_a_server_at_all_addresses_is_known_by_numbers_but_not_by_any_name(monkeypatch):
    monkeypatch.setattr("sonoservo.systems.display.pages.site.gethostname", lambda: "Theatre3")
    for host in ("192.0.2.7:7000", "[2001:db8::7]:7000", "theatre3:7000", "localhost:7000"):
        assert asks(EVERYWHERE, host) is None
    for host in ("evil.example", "theatre3.evil.example", "192.0.2.7.evil.example", "", "*"):
        assert "does not name this server" in asks(EVERYWHERE, host)
    assert EVERYWHERE.public_name == "Theatre3"


def test_the_given_host_is_a_name_of_the_server():
    assert asks(Access("Theatre3.local", token="secret"), "theatre3.local:7000") is None
    assert Access("fe80::1").public_name == "[fe80::1]"
    assert asks(Access("fe80::1", token="secret"), "[fe80::1]:7000") is None


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "", "http://localhost:9999", "https://localhost:7000",
     "http://localhost:7000.evil.example", "http://127.0.0.1:7000"],
)  # fmt: skip
def test_pages_of_other_origins_are_refused(origin):
    assert "another page" in asks(HERE, "localhost:7000", None, websocket=True)  # it must name one
    for websocket in (False, True):
        assert "another page" in asks(HERE, "localhost:7000", origin, websocket=websocket)


@pytest.mark.parametrize("tokens", [(), ("",), ("Secret",), ("secre",), ("secret2", "ä"), ("\0",)])
def test_a_missing_or_wrong_token_is_refused(tokens):
    assert "token" in asks(HERE, "localhost:7000", tokens=tokens)


def test_either_token_will_do_and_none_is_printed():
    assert asks(HERE, "localhost:7000", tokens=("", "secret")) is None
    assert "secret" not in repr(HERE)
    assert Access().token == Access("*").token
    assert len(Access().token) >= 32
