import socket
import time
from contextlib import ExitStack, suppress

import numpy as np
import pyigtl
import pytest
from live_items import make_volume, wait_until
from openigtlink import free_port

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live import Link, LiveSource, parse_address
from sonoservo.systems.live.connection import framing, link
from sonoservo.systems.live.connection.items import TextItem
from sonoservo.systems.live.connection.open_igt_link import encode
from sonoservo.systems.live.feeds import volume_items


class Ear:
    """Keeps what a link receives and reports."""

    def __init__(self):
        self.items, self.lines = [], []

    def receive(self, item, now, peer):
        self.items.append(item)

    def open(self, address):
        return Link(parse_address(address), self.receive, self.lines.append)

    def said(self, text):
        return [line for line in self.lines if text in line]


@pytest.fixture
def ear():
    return Ear()


@pytest.fixture
def server(ear):
    with ear.open("igtl://:0") as opened:
        yield opened


def plug(server):
    return socket.create_connection(("127.0.0.1", server.port), timeout=20)


def message(text, size=0):
    return encode(TextItem("T", 1.0, text.ljust(size)))


def test_address_is_read():
    address = parse_address("igtl://host:123/Image")
    assert (address.host, address.port, address.device) == ("host", 123, "Image")
    assert not address.listens
    assert parse_address("igtl://host").port == 18944
    assert parse_address("igtl://[::1]:5").bound == ("::1", 5)
    assert str(parse_address("igtl://[::1]:5/X")) == "igtl://[::1]:5"
    for text, bound in (("igtl://:9", "127.0.0.1"), ("igtl://0.0.0.0:9", "0.0.0.0")):
        assert parse_address(text).listens
        assert parse_address(text).bound == (bound, 9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("igtl:/host", "is no address; igtl://host:18944/DEVICE connects"),
        ("igtl://host:12/" + 21 * "x", "is no address"),
        ("igt://host", "unknown protocol 'igt'; known: igtl"),
    ],
)
def test_wrong_address_is_refused(text, message):
    with pytest.raises(ConfigurationError, match=message):
        parse_address(text)


def test_port_that_is_taken_is_one_line(server, ear):
    with pytest.raises(OSError, match=rf"igtl://:{server.port}: cannot listen there: Address"):
        ear.open(f"igtl://:{server.port}").start()


def test_lost_connection_is_taken_up_again(ear):
    port = free_port()
    with ear.open(f"igtl://localhost:{port}") as client:
        for number in range(2):
            with Ear().open(f"igtl://:{port}") as server:
                wait_until(lambda: server.peers and client.peers)
                server.send([TextItem("T", 1.0, f"{number}")])
                wait_until(lambda: len(ear.items) > number)  # noqa: B023
    assert [item.text for item in ear.items] == ["0", "1"]
    assert ear.said("connection lost")


def test_nobody_who_listens_is_said_at_growing_intervals(ear, monkeypatch):
    for name, value in (("_FIRST_RETRY", 0.01), ("_LAST_RETRY", 0.01), ("_FIRST_QUIET", 0.1)):
        monkeypatch.setattr(link, name, value)
    with ear.open(f"igtl://localhost:{free_port()}"):
        time.sleep(1.0)  # said after 0, 0.1, 0.3 and 0.7 s
    assert 2 <= len(ear.said("trying again; Ctrl-C ends")) <= 4


def test_slow_client_loses_old_volumes_and_holds_nobody_up(server):
    fast = Ear()
    with plug(server) as slow, fast.open(f"igtl://localhost:{server.port}"):
        wait_until(lambda: server.peers == 2)
        for number in range(20):
            items = [TextItem("T", float(number), f"{number:<60000}")] * 50
            server.send(items, topic="volume", keep=2)
            wait_until(lambda: len(fast.items) == 50 * (number + 1))  # noqa: B023
        assert server.dropped > 5
        assert max(len(peer.outbox._waiting) for peer in server._peers) <= 2
        # What it gets in the end is whole, in order, and the newest.
        framer, stamps = framing.Framer({"STRING": 1 << 20}), []
        while stamps.count(19) < 50:
            count = slow.recv_into(framer.buffer)
            stamps += [frame.header.time for frame in framer.advance(count, 0.0)]
    assert stamps == sorted(stamps)
    assert len(stamps) < 1000
    assert all(stamps.count(stamp) == 50 for stamp in stamps)


def test_hanging_client_is_given_up(server, ear, monkeypatch):
    monkeypatch.setattr(link, "_HUNG", 0.3)
    with plug(server):
        wait_until(lambda: server.peers == 1)
        for number in range(200):
            server.send([TextItem("T", 1.0, f"{number:<60000}")], keep=200)
        wait_until(lambda: ear.said("it takes nothing of what it is sent"))
        assert server.peers == 0


def test_byte_by_byte_is_too_slow(server, ear, monkeypatch):
    monkeypatch.setattr(framing, "_HEADER_PATIENCE", 0.3)
    with plug(server) as slow, pytest.raises(OSError):  # noqa: PT011, PT012
        for byte in message("never arrives") * 10:
            slow.sendall(bytes([byte]))
            time.sleep(0.05)
    wait_until(lambda: ear.said("it is too slow to finish a message"))
    assert ear.said("127.0.0.1:")


def test_nonsense_is_cut_off_and_others_go_on(server, ear):
    with plug(server) as good, plug(server) as bad:
        bad.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept: text/html,application/xml\r\n")
        wait_until(lambda: server.peers == 1)
        good.sendall(message("fine"))
        wait_until(lambda: ear.items)
    (line,) = ear.said("cut off")
    assert line.startswith("127.0.0.1:")
    assert "not OpenIGTLink" in line


def test_idle_peers_make_room_and_useful_ones_stay(server, ear, monkeypatch):
    monkeypatch.setattr(link, "_MAX_PEERS", 20)
    with plug(server) as good:
        good.sendall(message("useful"))
        wait_until(lambda: ear.items)
        idle = [plug(server) for _ in range(60)]
        wait_until(lambda: server.peers == 20 and ear.said("it was of least use"))
        assert len(ear.lines) <= 5
        good.sendall(message("still there"))
        wait_until(lambda: len(ear.items) == 2)
        with plug(server) as newcomer:
            newcomer.sendall(message("let in"))
            wait_until(lambda: len(ear.items) == 3)
        for peer in idle:
            peer.close()
        wait_until(lambda: server.peers == 1)


def test_unfinished_messages_share_one_budget(server, ear, monkeypatch):
    """A header alone reserves nothing; what has arrived counts, and a proved peer stays."""
    monkeypatch.setattr(link, "MAX_HELD", 8 << 20)
    announced = message("x")[:42] + (1 << 27).to_bytes(8, "big") + bytes(8)
    head = announced.replace(b"STRING", b"IMAGE\0", 1)
    with plug(server) as good, ExitStack() as stack:
        good.sendall(message("useful"))
        wait_until(lambda: ear.items)
        greedy = [stack.enter_context(plug(server)) for _ in range(6)]
        for peer in greedy:
            peer.sendall(head)
        wait_until(lambda: server.peers == 7)
        for peer in greedy:
            with suppress(OSError):
                peer.sendall(bytes(3 << 20))
        wait_until(lambda: ear.said("unfinished messages take more than 8 MB"))
        good.sendall(message("still there"))
        wait_until(lambda: len(ear.items) == 2)


def test_source_gives_the_newest_and_counts_what_it_drops(server):
    """Up to 64 wait for the first to be worked on, since that may take long."""
    address = parse_address(f"igtl://localhost:{server.port}")
    with LiveSource(address, report=lambda line: None) as source:
        assert "no volume has come from igtl://localhost" in source.take().reason
        wait_until(lambda: server.peers == 1)
        for k in range(2):
            server.send(volume_items(make_volume(0.1 + 0.1 * k)), topic=f"{k}")
        assert [source.take(5.0).time for _ in range(2)] == [0.1, 0.2]
        for k in range(5):
            server.send(volume_items(make_volume(1.0 + k)), topic=f"{k}")
        wait_until(lambda: source.dropped == 4)
        volume = source.take(5.0)
    assert volume.time == 5.0
    np.testing.assert_array_equal(volume.intensities, make_volume().intensities)
    assert source.posed


def test_client_of_pyigtl_receives_and_sends(server, ear):
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", server.port)
    try:
        wait_until(lambda: server.peers == 1)
        volume = make_volume()
        server.send(volume_items(volume))
        image = client.wait_for_message("Image_Probe", timeout=20)
        np.testing.assert_array_equal(image.image, volume.intensities.transpose(2, 1, 0))
        client.send_message(pyigtl.StringMessage("hello", device_name="Hi"))
        wait_until(lambda: ear.items)
    finally:
        client.stop()
    assert (ear.items[0].name, ear.items[0].text) == ("Hi", "hello")
