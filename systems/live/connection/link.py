"""A live connection: one thread that reads, writes, connects again and refuses what is wrong."""

import asyncio
import errno
import re
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, Self

from sonoservo.systems.live.connection.address import Address
from sonoservo.systems.live.connection.framing import Frame, FramingError
from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.live.connection.open_igt_link import decode, encode, make_framer

MAX_HELD = 1 << 29
"""Bytes reserved at most for the unfinished messages of all peers together."""

_MAX_PEERS = 256
_PIECE = 1 << 18  # Bytes that are written at once, and so the most that waits outside of an outbox
_HUNG = 30.0  # Time in s after which a peer that takes nothing of what waits for it is given up
_FIRST_RETRY, _LAST_RETRY, _CONNECTING = 0.1, 2.0, 5.0
_FIRST_QUIET, _LAST_QUIET = 10.0, 300.0  # Times in s between lines that say there is no connection
_TICK = 0.25
# Time in s in which at most so many lines about one host are printed.
_REPORT_EVERY, _REPORTS = 10.0, 5
_LONGEST_LINE, _SKIPPED = 400, 32


def shown(text: str) -> str:
    """Return a text on one line in which nothing acts on a terminal: escapes are spelt out."""
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode() for each in text
    )[:_LONGEST_LINE]


class _Peer(asyncio.BufferedProtocol):
    """One connection, whose bytes go straight into the memory of its message."""

    def __init__(self, link: "Link", name: str = "") -> None:
        self.link, self.name = link, name
        self.framer = make_framer()
        self.outbox = Outbox()
        self.useful = self.taken = time.perf_counter()
        self.proved = self.paused = False
        self.left = 0
        self.gone = asyncio.Event()
        self.transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport
        self.transport.set_write_buffer_limits(high=0)
        if not self.name:
            host, port, *_ = transport.get_extra_info("peername") or ("a peer", 0)
            self.name = f"{host}:{port}"
        self.link.welcome(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        return self.framer.buffer

    def buffer_updated(self, nbytes: int) -> None:
        self.link.read(self, nbytes)

    def pause_writing(self) -> None:
        self.paused = True

    def resume_writing(self) -> None:
        self.paused = False
        self.link.write(self)

    def connection_lost(self, exc: Exception | None) -> None:
        reason = getattr(exc, "strerror", None) or str(exc or "closed by the peer")
        self.link.drop(self, f"connection lost: {reason}")
        self.gone.set()

    def has_proved(self, now: float) -> None:
        """Note that the peer has just sent something of use, or taken something."""
        self.proved, self.useful = True, now


class Link:
    """A connection that is kept up, or a port that any number of peers connect to.

    Use it as a context manager. `receive` is called with every item, the time of its last byte
    (`time.perf_counter`) and the peer's name, on the link's own thread, so it must be quick;
    `report` with one printable line for a person. A message that sets off an error is left out, a
    peer whose bytes make no sense is cut off and may come again. All peers share one budget of
    memory and of connections; when it is spent, those leave first that never sent or took anything
    of use, then those that did so longest ago.

    `dropped` counts messages that newer ones replaced, `refused` those left out, and `skipped`
    those of no use here, by type. `failure` is the error that ended the link's thread, if any.
    """

    def __init__(
        self,
        address: Address,
        receive: Callable[[Item, float, str], None] | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self.address = address
        self._receive, self._report = receive, report
        self._lock = threading.Lock()
        self._peers: list[_Peer] = []
        self._reported: dict[str, tuple[float, int]] = {}
        self._listener: socket.socket | None = None
        self._loop = asyncio.new_event_loop()
        self._ending = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name=str(address), daemon=True)
        self.dropped = self.refused = 0
        self.skipped: Counter[str] = Counter()
        self.failure: Exception | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def start(self) -> None:
        """Begin to listen or to connect; an OSError if the port is taken, or not ours."""
        if self.address.listens:
            six = ":" in self.address.host
            try:
                self._listener = socket.create_server(
                    self.address.bound,
                    family=socket.AF_INET6 if six else socket.AF_INET,
                    backlog=128,
                    dualstack_ipv6=six and socket.has_dualstack_ipv6(),
                )
            except OSError as error:
                self._loop.close()
                reason = (error.strerror or str(error)).partition(" (while")[0]
                raise OSError(f"{self.address}: cannot listen there: {reason}") from error
        self._thread.start()

    def close(self) -> None:
        """End the connection; what waits to be sent is lost (see `flush`)."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ending.set)
            self._thread.join()
        self._loop.close()
        if self._listener is not None:
            self._listener.close()

    @property
    def port(self) -> int:
        """Port that is listened on, also where the address leaves it to the system (0)."""
        return self._listener.getsockname()[1] if self._listener else self.address.port

    @property
    def peers(self) -> int:
        """Number of peers that are connected."""
        return len(self._peers)

    def say(self, line: str) -> None:
        """Report a line, in which nothing of a foreign peer acts on a terminal."""
        self._report(shown(line))

    def send(self, items: Sequence[Item], topic: str = "", keep: int | None = None) -> None:
        """Send items together to every peer; never waits.

        For a slow peer, at most ``keep`` of a topic wait, by default that of the first item's name;
        newer ones take the place of older ones.
        """
        if not self._peers or not items:
            return
        data = b"".join(map(encode, items))
        with self._lock:
            for peer in self._peers:
                self.dropped += peer.outbox.put(data, topic or items[0].name, keep)
            if not self._ending.is_set():
                self._loop.call_soon_threadsafe(self._write_all)

    def flush(self, timeout: float) -> bool:
        """Wait at most ``timeout`` s until everything has been sent; return whether it has."""
        end = time.perf_counter() + timeout
        while time.perf_counter() < end:
            with self._lock:
                if not any(peer.outbox or peer.paused for peer in self._peers):
                    return True
            time.sleep(0.001)
        return False

    # The methods below are called on the link's own thread.

    def welcome(self, peer: _Peer) -> None:
        """Take in a peer; if there are too many, the one that is of least use leaves."""
        if not self.address.listens:
            self._tell(peer.name, "connected")
        if len(self._peers) >= _MAX_PEERS:
            reason = f"cut off: {_MAX_PEERS} peers are connected, and it was of least use"
            self.drop(self._least_useful(self._peers), reason)
        with self._lock:
            self._peers.append(peer)

    def read(self, peer: _Peer, count: int) -> None:
        """Take in bytes of a peer."""
        now = time.perf_counter()
        try:
            for frame in peer.framer.advance(count, now):
                self._take(peer, frame, now)
        except FramingError as error:
            self.drop(peer, f"cut off: {error}")
        while sum(each.framer.held for each in self._peers) > MAX_HELD:
            holding = [each for each in self._peers if each.framer.held]
            reason = f"cut off: unfinished messages take more than {MAX_HELD >> 20} MB in all"
            self.drop(self._least_useful(holding), reason)

    def write(self, peer: _Peer) -> None:
        """Give the socket what it takes."""
        while not peer.paused and peer in self._peers:
            with self._lock:
                piece = peer.outbox.next()[:_PIECE]
                peer.outbox.sent(len(piece))
            if not piece:
                return
            peer.taken = time.perf_counter()
            peer.has_proved(peer.taken)
            peer.transport.write(piece)

    def drop(self, peer: _Peer, reason: str) -> None:
        """Let a peer go; its host may connect again."""
        if peer in self._peers:
            with self._lock:
                self._peers.remove(peer)
            peer.transport.abort()
            peer.framer = make_framer()  # its memory is free at once
            self._tell(peer.name, reason)

    def _take(self, peer: _Peer, frame: Frame, now: float) -> None:
        """Take in a message. Whatever it sets off is its own fault, and costs it alone."""
        try:
            items = decode(frame)
            if not items and (len(self.skipped) < _SKIPPED or str(frame) in self.skipped):
                self.skipped[str(frame)] += 1
            for item in items:
                peer.has_proved(now)
                if self._receive is not None:
                    self._receive(item, now, peer.name)
        except Exception as error:
            self.refused += 1
            reason = " ".join(str(error).split()) or type(error).__name__
            self._tell(peer.name, f"a message is left out: {reason}")

    def _least_useful(self, peers: Sequence[_Peer]) -> _Peer:
        return min(peers, key=lambda peer: (peer.proved, peer.useful))

    def _tell(self, peer: str, line: str) -> None:
        """Report a line about a peer, unless there were many about its host of late."""
        host = peer.rpartition(":")[0]
        since, count = self._reported.get(host, (-_REPORT_EVERY, 0))
        now = time.perf_counter()
        if now - since > _REPORT_EVERY:
            more = f" (and {count - _REPORTS} more lines like this before)"
            self.say(f"{peer}: {line}" + (more if count > _REPORTS else ""))
            self._reported[host] = (now, 1)
        else:
            if count < _REPORTS:
                self.say(f"{peer}: {line}")
            self._reported[host] = (since, count + 1)

    def _write_all(self) -> None:
        for peer in list(self._peers):
            self.write(peer)

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._live())
        except Exception as error:  # handed on, so that nobody waits for a thread that has ended
            self.failure = error

    async def _live(self) -> None:
        """Listen or stay connected, and watch the peers, until the end."""
        work = self._listen() if self.address.listens else self._stay_connected()
        tasks = [asyncio.create_task(each) for each in (work, self._watch(), self._ending.wait())]
        done, others = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in others:
            task.cancel()
        self._ending.set()
        for peer in list(self._peers):
            peer.transport.abort()
        with self._lock:
            self._peers.clear()
        for task in done:
            task.result()

    async def _listen(self) -> None:
        assert self._listener is not None
        server = await self._loop.create_server(lambda: _Peer(self), sock=self._listener)
        async with server:
            await server.serve_forever()

    async def _stay_connected(self) -> None:
        name = str(self.address)
        retry, quiet, due = _FIRST_RETRY, _FIRST_QUIET, 0.0
        while True:
            try:
                async with asyncio.timeout(_CONNECTING):
                    _, peer = await self._loop.create_connection(
                        lambda: _Peer(self, name), *self.address.bound
                    )
            except TimeoutError:
                reason = "no answer"
            except OSError as error:
                code = re.search(r"Errno (-?\d+)", repr(error) + str(error))
                number = error.errno or int(code[1] if code else 0)
                reason = errno.errorcode.get(number, error.strerror or str(error))
            else:
                retry, quiet, due = _FIRST_RETRY, _FIRST_QUIET, 0.0
                await peer.gone.wait()
                await asyncio.sleep(_FIRST_RETRY)
                continue
            if (now := time.perf_counter()) >= due:
                self._tell(name, f"no connection ({reason}); trying again; Ctrl-C ends")
                due, quiet = now + quiet, min(2 * quiet, _LAST_QUIET)
            await asyncio.sleep(retry)
            retry = min(2 * retry, _LAST_RETRY)

    async def _watch(self) -> None:
        """Give up peers that hang."""
        while True:
            await asyncio.sleep(_TICK)
            now = time.perf_counter()
            for peer in list(self._peers):
                left = peer.transport.get_write_buffer_size()
                if left != peer.left:
                    peer.left, peer.taken = left, now
                if peer.framer.is_overdue(now):
                    self.drop(peer, "cut off: it is too slow to finish a message")
                elif left and now - peer.taken > _HUNG:
                    self.drop(peer, "cut off: it takes nothing of what it is sent")


class Outbox:
    """Messages for a peer, at most ``keep`` of a topic; one that has begun is sent to its end."""

    def __init__(self, keep: int = 64) -> None:
        self._keep = keep
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._counts: Counter[str] = Counter()
        self._under_way = memoryview(b"")

    def __bool__(self) -> bool:
        return bool(self._under_way) or bool(self._waiting)

    def put(self, data: bytes, topic: str, keep: int | None = None) -> int:
        """Add a message of a topic, of which at most ``keep`` wait; return how many give way."""
        dropped = 0
        self._waiting.append((topic, data))
        self._counts[topic] += 1
        while self._counts[topic] > (self._keep if keep is None else keep):
            oldest = next(k for k, (each, _) in enumerate(self._waiting) if each == topic)
            del self._waiting[oldest]
            self._counts[topic] -= 1
            dropped += 1
        return dropped

    def next(self) -> memoryview:
        """Return what is to be sent now; empty if there is nothing."""
        if not self._under_way and self._waiting:
            topic, data = self._waiting.popleft()
            self._counts[topic] -= 1
            self._under_way = memoryview(data)
        return self._under_way

    def sent(self, count: int) -> None:
        """Drop so many bytes that were sent."""
        self._under_way = self._under_way[count:]
