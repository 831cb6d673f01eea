import io
import logging
import socket
import sys
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from rich.console import Console
from typer.testing import CliRunner

from sonoservo.diagrams.app.cli import app
from sonoservo.diagrams.app.terminal import keep_shown, open_site, start_display, start_monitor
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


def test_only_this_machine_reaches_the_pages_unless_told_otherwise():
    if OUTSIDE is None:
        pytest.skip("this machine has no address but its own loop")
    with open_site() as private, open_site("*") as public:
        meshcat = start_display(Console(quiet=True), private)
        assert connects("localhost", private.port)
        assert not connects(OUTSIDE, private.port)
        assert not connects(OUTSIDE, meshcat.port())
        assert connects(OUTSIDE, public.port)


def test_a_busy_port_is_stepped_over_and_the_addresses_printed():
    console = Console(record=True, quiet=False)
    with open_site() as first, open_site() as second:
        assert first.port != second.port
        for site in (first, second):
            urls = [start_display(console, site).web_url(), start_monitor(console, site).web_url]
            shown = console.export_text()
            assert f"Watch at {urls[0]}\n" in shown
            assert f"The scanner's monitor: {urls[1]}\n" in shown
            for url in urls:
                assert urlsplit(url).netloc == f"localhost:{site.port}"
                assert urlopen(url).status == 200


def test_a_page_that_is_late_for_a_picture_is_no_news(caplog):
    with open_site() as site:
        meshcat = start_display(Console(quiet=True), site)
        with pytest.raises(HTTPError, match="404: CAS key not found"):
            urlopen(meshcat.web_url().replace("?", f"cas-v1/{64 * '0'}?"))
    logging.getLogger("drake").warning("Meshcat: Malformed CAS key torn")
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [
        "Meshcat: Malformed CAS key torn"
    ]


@pytest.mark.parametrize("host", ["198.51.100.7", "no such host"])
def test_an_address_of_another_machine_is_refused(host):
    with pytest.raises(ConfigurationError, match="host: .* address of this machine"):
        open_site(host)


def test_a_wrong_host_ends_the_command_before_anything_is_written(tmp_path):
    arguments = ["run", "chatelain2013_fig5", "--host", "no such host"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, ConfigurationError)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("typed", "left"), [("\nnext", "next"), ("", "")])
def test_a_picture_stays_until_enter_or_the_end_of_input(monkeypatch, typed, left):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal, said = Terminal(typed), io.StringIO()
    monkeypatch.setattr("sys.stdin", terminal)
    keep_shown(Console(file=said, force_interactive=True))
    assert "press Enter" in said.getvalue()
    assert terminal.read() == left


def test_nobody_at_a_terminal_is_waited_for(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("kept"))
    said = io.StringIO()
    keep_shown(Console(file=said, force_interactive=True))
    assert said.getvalue() == ""
    assert sys.stdin.read() == "kept"
