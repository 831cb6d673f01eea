"""Bounded queue of messages to one peer; when it is full, the oldest of a topic make way."""

from collections import Counter, deque


class Outbox:
    """Messages for a peer, at most ``keep`` of a topic; one that has begun is sent to its end."""

    def __init__(self, keep: int = 64) -> None:
        self._keep = keep
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._counts: Counter[str] = Counter()
        self._under_way = memoryview(b"")
        self.dropped: Counter[str] = Counter()

    def __bool__(self) -> bool:
        return bool(self._under_way) or bool(self._waiting)

    def put(self, data: bytes, topic: str, keep: int | None = None) -> None:
        """Add a message of a topic, of which at most ``keep`` wait."""
        self._waiting.append((topic, data))
        self._counts[topic] += 1
        while self._counts[topic] > (self._keep if keep is None else keep):
            oldest = next(k for k, (each, _) in enumerate(self._waiting) if each == topic)
            del self._waiting[oldest]
            self._counts[topic] -= 1
            self.dropped[topic] += 1

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
