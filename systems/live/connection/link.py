"""A live connection: one thread that reads, writes, connects again and refuses what is wrong."""

import errno
import selectors
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from sonoservo.systems.live.connection.framing import FramingError, MessageError
from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.live.connection.outbox import Outbox
from sonoservo.systems.live.connection.protocols import Address, StreamFramer, load_protocol

_MAX_PEERS = 64
_HUNG = 30.0
"""Time in s after which a peer that takes nothing of what waits for it is given up."""

_FIRST_RETRY, _LAST_RETRY = 0.1, 2.0
_TICK = 0.25
_REPORT_EVERY, _REPORTS = 10.0, 5
"""Time in s in which at most so many lines about one host are printed."""


@dataclass(eq=False)
class _Peer:
    socket: socket.socket
    name: str
    framer: StreamFramer
    outbox: Outbox = field(default_factory=Outbox)
    taken: float = 0.0
    writing: bool = False


class Link:
    """A connection that is kept up, or a port that any number of peers connect to.

    Use it as a context manager, or call `start` and `close`. Faults of a peer are one line each to
    ``report``; a peer whose bytes make no sense is cut off, and may come again.

    Parameters
    ----------
    address
        Address to connect to or to listen on.
    receive
        Function that is called with every received item and the time of its last byte
        (`time.perf_counter`); on the link's own thread, so it must be quick.
    report
        Function that is called with one line for a person, on any thread.
    """

    def __init__(
        self,
        address: Address,
        receive: Callable[[Item, float], None] | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self.address = address
        self._protocol = load_protocol(address.scheme)
        self._receive, self._say = receive, report
        self._lock = threading.Lock()
        self._peers: list[_Peer] = []
        self._reported: dict[str, tuple[float, int]] = {}
        self._selector = selectors.DefaultSelector()
        self._ears, self._mouth = socket.socketpair()
        self._listener: socket.socket | None = None
        self._connecting: socket.socket | None = None
        self._retry_at, self._retry = 0.0, _FIRST_RETRY
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=str(address), daemon=True)
        self.dropped = 0

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def start(self) -> None:
        """Begin to listen or to connect.

        Raises
        ------
        OSError
            If the port is taken, or not ours to listen on.
        """
        self._ears.setblocking(False)
        self._selector.register(self._ears, selectors.EVENT_READ)
        if self.address.listens:
            family = socket.AF_INET6 if ":" in self.address.host else socket.AF_INET
            self._listener = socket.socket(family, socket.SOCK_STREAM)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                self._listener.bind(self.address.bound)
                self._listener.listen(128)
            except OSError as error:
                self._listener.close()
                raise OSError(f"{self.address}: cannot listen there: {error.strerror}") from error
            self._listener.setblocking(False)
            self._selector.register(self._listener, selectors.EVENT_READ)
        self._thread.start()

    def close(self) -> None:
        """End the connection; what waits to be sent is lost (see `flush`)."""
        self._closed = True
        self._wake()
        if self._thread.ident is not None:
            self._thread.join()
        for each in [*(peer.socket for peer in self._peers), self._listener, self._connecting]:
            if each is not None:
                each.close()
        self._peers.clear()
        self._selector.close()
        self._ears.close()
        self._mouth.close()

    @property
    def port(self) -> int:
        """Port that is listened on, also where the address leaves it to the system (0)."""
        return self._listener.getsockname()[1] if self._listener else self.address.port

    @property
    def peers(self) -> int:
        """Number of peers that are connected."""
        return len(self._peers)

    def send(self, items: Sequence[Item], topic: str = "", keep: int | None = None) -> None:
        """Send items to every peer; never waits.

        Parameters
        ----------
        items
            They are sent, or dropped, together.
        topic
            Items of the same topic that are newer take the place of older ones in the queue of a
            peer that is too slow; by default the first item's name.
        keep
            Number of them that may wait.
        """
        if not self._peers or not items:
            return
        data = b"".join(map(self._protocol.encode, items))
        with self._lock:
            for peer in self._peers:
                if not peer.outbox:
                    peer.taken = time.perf_counter()
                before = peer.outbox.dropped.total()
                peer.outbox.put(data, topic or items[0].name, keep)
                self.dropped += peer.outbox.dropped.total() - before
        self._wake()

    def flush(self, timeout: float) -> bool:
        """Wait at most ``timeout`` s until everything has been sent; return whether it has."""
        end = time.perf_counter() + timeout
        while time.perf_counter() < end:
            with self._lock:
                if not any(peer.outbox for peer in self._peers):
                    return True
            time.sleep(0.001)
        return False

    def _report(self, peer: str, line: str) -> None:
        """Report a line about a peer, unless there were many about its host of late."""
        host = peer.rpartition(":")[0]
        since, count = self._reported.get(host, (-_REPORT_EVERY, 0))
        now = time.perf_counter()
        if now - since > _REPORT_EVERY:
            more = f" (and {count - _REPORTS} more lines like this before)"
            self._say(f"{peer}: {line}" + (more if count > _REPORTS else ""))
            self._reported[host] = (now, 1)
        else:
            if count < _REPORTS:
                self._say(f"{peer}: {line}")
            self._reported[host] = (since, count + 1)

    def _wake(self) -> None:
        with suppress(OSError):
            self._mouth.send(b"\0", socket.MSG_DONTWAIT)

    def _run(self) -> None:
        while not self._closed:
            if self._listener is None and not self._peers and self._connecting is None:
                self._connect()
            self._mark_writers()
            for key, events in self._selector.select(_TICK):
                if key.fileobj is self._ears:
                    with suppress(BlockingIOError):
                        self._ears.recv(4096)
                elif key.fileobj is self._listener:
                    self._accept(self._listener)
                elif key.fileobj is self._connecting:
                    self._connected(self._connecting)
                else:
                    self._serve(key.data, events)
            self._check_patience()

    def _connect(self) -> None:
        now = time.perf_counter()
        if now < self._retry_at:
            time.sleep(min(self._retry_at - now, _TICK))
            return
        try:
            found = socket.getaddrinfo(*self.address.bound, type=socket.SOCK_STREAM)
        except OSError as error:
            self._failed(error.strerror or str(error))
            return
        family, kind, number, _, place = found[0]
        self._connecting = socket.socket(family, kind, number)
        self._connecting.setblocking(False)
        self._selector.register(self._connecting, selectors.EVENT_WRITE)
        self._connecting.connect_ex(place)
        self._retry_at = now + max(self._retry, 5.0)  # until when it may take

    def _connected(self, connecting: socket.socket) -> None:
        self._selector.unregister(connecting)
        self._connecting = None
        code = connecting.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            connecting.close()
            self._failed(errno.errorcode.get(code, str(code)))
            return
        self._retry = _FIRST_RETRY
        self._report(str(self.address), "connected")
        self._welcome(connecting, str(self.address))

    def _failed(self, reason: str) -> None:
        self._report(str(self.address), f"no connection ({reason}); trying again")
        self._retry_at = time.perf_counter() + self._retry
        self._retry = min(2 * self._retry, _LAST_RETRY)

    def _accept(self, listener: socket.socket) -> None:
        try:
            accepted, place = listener.accept()
        except OSError:
            return
        name = f"{place[0]}:{place[1]}"
        if len(self._peers) >= _MAX_PEERS:
            accepted.close()
            self._report(name, f"refused, {_MAX_PEERS} peers are connected already")
            return
        self._welcome(accepted, name)

    def _welcome(self, connected: socket.socket, name: str) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer = _Peer(connected, name, self._protocol.make_framer(), taken=time.perf_counter())
        self._selector.register(connected, selectors.EVENT_READ, peer)
        with self._lock:
            self._peers.append(peer)

    def _mark_writers(self) -> None:
        for peer in self._peers:
            if bool(peer.outbox) != peer.writing:
                peer.writing = not peer.writing
                events = selectors.EVENT_READ | (selectors.EVENT_WRITE if peer.writing else 0)
                self._selector.modify(peer.socket, events, peer)

    def _serve(self, peer: _Peer, events: int) -> None:
        try:
            if events & selectors.EVENT_WRITE:
                self._write(peer)
            if events & selectors.EVENT_READ:
                self._read(peer)
        except BlockingIOError:
            pass
        except FramingError as error:
            self._drop(peer, f"cut off: {error}")
        except OSError as error:
            self._drop(peer, f"connection lost: {error.strerror or error}")

    def _read(self, peer: _Peer) -> None:
        count = peer.socket.recv_into(peer.framer.buffer)
        now = time.perf_counter()
        if not count:
            self._drop(peer, "connection lost: closed by the peer")
            return
        for frame in peer.framer.advance(count, now):
            try:
                for item in self._protocol.decode(frame):
                    if self._receive is not None:
                        self._receive(item, now)
            except MessageError as error:
                self._report(peer.name, f"a message is left out: {error}")

    def _write(self, peer: _Peer) -> None:
        with self._lock:
            data = peer.outbox.next()
        if data:
            count = peer.socket.send(data[: 1 << 18])
            peer.taken = time.perf_counter()
            with self._lock:
                peer.outbox.sent(count)

    def _check_patience(self) -> None:
        now = time.perf_counter()
        if self._connecting is not None and now > self._retry_at:
            self._selector.unregister(self._connecting)
            self._connecting.close()
            self._connecting = None
            self._failed("no answer")
        for peer in list(self._peers):
            if peer.framer.is_overdue(now):
                self._drop(peer, "cut off: it is too slow to finish a message")
            elif peer.outbox and now - peer.taken > _HUNG:
                self._drop(peer, "cut off: it takes nothing of what it is sent")

    def _drop(self, peer: _Peer, reason: str) -> None:
        with self._lock:
            self._peers.remove(peer)
        self._selector.unregister(peer.socket)
        peer.socket.close()
        self._report(peer.name, reason)
        self._retry_at = time.perf_counter() + _FIRST_RETRY
