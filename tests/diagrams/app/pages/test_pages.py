import io
import logging
import socket
import sys
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from rich.console import Console

from sonoservo.diagrams.app.options import Page
from sonoservo.diagrams.app.pages import pages as pages_module
from sonoservo.diagrams.app.pages.pages import has_desktop, open_pages
from sonoservo.systems.files.refusals import ConfigurationError

# Any address of this machine that is not its own loop, found without sending anything.
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as _probe:
    try:
        _probe.connect(("192.0.2.1", 9))
        OUTSIDE = _probe.getsockname()[0]
    except OSError:
        OUTSIDE = None


def connects(host, port):
    try:
        socket.create_connection((host, port), timeout=2).close()
    except OSError:
        return False
    return True


@pytest.fixture
def opened():
    """Opens pages, and closes them."""
    kept = []

    def open_them(console, **options):
        kept.append(open_pages("a test", **options))
        kept[-1].announce(console)
        return kept[-1]

    yield open_them
    for each in kept:
        each.site.close()


def test_only_this_machine_reaches_the_pages_unless_told_otherwise(opened):
    if OUTSIDE is None:
        pytest.skip("this machine has no address but its own loop")
    private = opened(Console(quiet=True))
    public = opened(Console(quiet=True), page=Page(host="*"), world=False)
    assert connects("localhost", private.site.port)
    assert not connects(OUTSIDE, private.site.port)
    assert not connects(OUTSIDE, private.meshcat.port())
    assert connects(OUTSIDE, public.site.port)


def test_a_busy_port_is_stepped_over_and_one_address_printed(opened):
    console = Console(record=True, quiet=False)
    ports = set()
    for _ in range(2):
        pages = opened(console)
        ports.add(pages.site.port)
        url = pages.console.web_url
        assert console.export_text().splitlines()[-1] == f"Watch at {url}"
        assert urlsplit(url).netloc == f"localhost:{pages.site.port}"
        for each in (url, pages.meshcat.web_url()):
            assert urlopen(each).status == 200
    assert len(ports) == 2


def test_a_page_that_is_late_for_a_picture_is_no_news(caplog, opened):
    meshcat = opened(Console(quiet=True)).meshcat
    with pytest.raises(HTTPError, match="404: CAS key not found"):
        urlopen(meshcat.web_url().replace("?", f"cas-v1/{64 * '0'}?"))
    logging.getLogger("drake").warning("Meshcat: Malformed CAS key torn")
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [
        "Meshcat: Malformed CAS key torn"
    ]


@pytest.mark.parametrize(
    ("variables", "desktop"),
    [
        ({}, False),
        ({"DISPLAY": ":0"}, True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, True),
        ({"DISPLAY": ":0", "SSH_CONNECTION": "192.0.2.1 22"}, False),
    ],
)
def test_the_page_opens_by_itself_where_there_is_a_desktop(monkeypatch, opened, variables, desktop):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SSH_CONNECTION"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.platform", "linux")
    assert has_desktop() == desktop
    if not desktop:
        return
    urls = []
    monkeypatch.setattr(pages_module.webbrowser, "open", urls.append)
    person = Console(file=io.StringIO(), force_interactive=True)
    page = opened(person, world=False)
    opened(person, page=Page(open_page=False), world=False)
    opened(Console(file=io.StringIO(), force_interactive=False), world=False)  # a batch
    assert urls == [page.console.web_url]


@pytest.mark.parametrize("host", ["198.51.100.7", "no such host"])
def test_an_address_of_another_machine_is_refused(host):
    with pytest.raises(ConfigurationError, match="host: .* address of this machine"):
        open_pages("a test", Page(host=host))


@pytest.mark.parametrize(("typed", "left"), [("\nnext", "next"), ("", "")])
def test_the_page_stays_until_enter_or_the_end_of_input(monkeypatch, opened, tmp_path, typed, left):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal, said = Terminal(typed), io.StringIO()
    monkeypatch.setattr("sys.stdin", terminal)
    pages = opened(Console(quiet=True), world=False)
    pages.console.controls.offer_buttons("pause")
    pages.console.say(note="press W to push the needle in")
    report = tmp_path / "report.html"
    report.write_text("<p>figures")
    (tmp_path / "run.png").write_bytes(b"picture")
    pages.end(Console(file=said, force_interactive=True), "32.0 s simulated", report)
    assert "press Enter" in said.getvalue()
    assert terminal.read() == left
    assert pages.console.facts["ended"] == "32.0 s simulated"
    assert not pages.console.facts["note"]
    assert pages.console.controls.description()["buttons"] == []
    address = pages.site.address("report")
    assert pages.console.facts["report"] == "../report/report.html"
    assert b"figures" in urlopen(address.replace("?", "report.html?")).read()
    assert urlopen(address.replace("?", "run.png?")).read() == b"picture"
    with pytest.raises(HTTPError, match="403"):
        urlopen(address.partition("?")[0] + "report.html")
    with pytest.raises(HTTPError, match="403|404"):
        urlopen(address.replace("?", "../../etc/passwd?"))


def test_nobody_at_a_terminal_is_waited_for(monkeypatch, opened):
    monkeypatch.setattr("sys.stdin", io.StringIO("kept"))
    said = io.StringIO()
    pages = opened(Console(quiet=True), world=False)
    pages.end(Console(file=said, force_interactive=True), "ended")
    assert said.getvalue() == ""
    assert sys.stdin.read() == "kept"
