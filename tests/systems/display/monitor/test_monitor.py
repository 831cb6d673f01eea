import gc
import socket
import subprocess
import sys
import threading
import tracemalloc
import urllib.request
from contextlib import closing

import numpy as np
import pytest
from meshcat.commands import SetProperty
from meshcat.path import Path

from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.monitor import PORT, Monitor
from sonoservo.systems.display.monitor.page_server import PageServer

PAGE = "<!-- VIEWER --><script>/* FEED */</script>"


@pytest.fixture
def monitor():
    with closing(Monitor()) as monitor:
        yield monitor


@pytest.fixture
def server():
    with closing(PageServer(page=PAGE, port=7700, asked=lambda: None)) as server:
        yield server


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def port_of(url):
    return int(url.rstrip("/").rpartition(":")[2])


def open_feed(url):
    """Open what a page's script opens, and read nothing but the answer to that."""
    connection = socket.create_connection(("localhost", port_of(url)), timeout=10)
    connection.sendall(
        f"GET /commands HTTP/1.1\r\nHost: localhost:{port_of(url)}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert connection.recv(12) == b"HTTP/1.1 101"
    return connection


def put(server, name, value):
    command = SetProperty("name", value, Path(("meshcat", name)))
    server.ask(lambda: server.send(command))


def test_a_busy_port_is_stepped_over(monitor):
    port = port_of(monitor.web_url)
    assert port >= PORT
    with closing(Monitor(port=port)) as other:
        assert port_of(other.web_url) > port


def test_what_is_wrong_with_a_host_or_a_port_is_said():
    with pytest.raises(ValueError, match="port: 0 is not allowed; it must be 1 to 65535"):
        Monitor(port=0)
    with pytest.raises(OSError, match=r"host: '192\.0\.2\.7' is no name or address of this machi"):
        Monitor(host="192.0.2.7")


def test_no_free_port_is_said():
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 65535))
        busy.listen()
        with pytest.raises(OSError, match="port: none of 65535 to 65535 is free on 'localhost'"):
            Monitor(port=65535)


def test_only_this_machine_can_connect(monitor):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: asks which address would be used
            address = probe.getsockname()[0]
        except OSError:
            address = "127.0.0.1"
    if address.startswith("127."):
        pytest.skip("this machine has no other address")
    socket.create_connection(("localhost", port_of(monitor.web_url)), timeout=5).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((address, port_of(monitor.web_url)), timeout=5)


def test_the_page_asks_for_nothing_else(monitor):
    text = urllib.request.urlopen(monitor.web_url).read().decode()
    assert text.count("src=") == 1
    script = urllib.request.urlopen(monitor.web_url + "main.min.js").read()
    assert b"MeshCat" in script
    assert f'src="{monitor.web_url}"' in monitor._repr_html_()


def test_nothing_is_drawn_for_nobody(monitor, make_volume):
    for time in range(5):
        monitor.show(make_volume(zeros, time=time))
    with closing(Monitor()) as other:
        empty = len(other.html())
    assert len(monitor._server.ask(monitor._server.html)) == empty
    assert len(monitor.html()) > empty + 10_000  # asked for, it is


def test_the_document_holds_what_the_newest_volume_shows(monitor, make_volume):
    monitor.show(make_volume(zeros))
    before = monitor.html()
    assert before == monitor.html()
    monitor.show(make_volume(lambda p_P: 100 + 1000 * p_P[..., 0]))
    assert before != monitor.html()


def test_no_garbage_is_collected_on_the_thread_that_draws(monitor, make_volume, monkeypatch):
    collects = []
    monkeypatch.setattr(MonitorScreen, "draw", lambda *_: collects.append(gc.isenabled()))
    monitor.show(make_volume(zeros))
    monitor.html()
    assert collects == [False]
    assert gc.isenabled()


def test_what_a_slow_page_did_not_read_is_left_out(server):
    """200 pictures of 1 MB for one that reads none of them: at the most a few are kept."""
    slow = open_feed(server.web_url)
    while not server.wanted:
        server.ask(lambda: None)
    tracemalloc.start()
    for number in range(200):
        put(server, "picture", str(number) * 500_000)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 20e6
    slow.close()
    put(server, "picture", "the end")  # nobody is hurt


def test_a_page_that_opens_gets_the_newest_of_each_object_alone(server):
    for number in range(3):
        put(server, "first", f"first {number}")
        put(server, "second", f"second {number}")
    with open_feed(server.web_url) as page:
        received = b""
        while b"second 2" not in received:
            received += page.recv(4096)
    assert [received.count(f"first {n}".encode()) for n in range(3)] == [0, 0, 1]
    assert received.count(b"second") == 2  # its path and its value


def test_showing_goes_on_after_the_end(monitor, make_volume):
    volume = make_volume(zeros)
    monitor.close()
    monitor.close()
    monitor.show(volume)


def test_nothing_is_left_behind_by_a_process_that_ends():
    count = threading.active_count()
    monitor = Monitor()
    assert threading.active_count() == count + 1
    monitor.close()
    assert threading.active_count() == count
    program = (
        "from sonoservo.systems.display.monitor.monitor import Monitor; print(Monitor().web_url)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("localhost", port_of(done.stdout.strip())), timeout=5)
