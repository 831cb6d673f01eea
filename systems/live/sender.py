"""The leaf that sends values over a live connection."""

from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.feeds import Feed
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive


class Sender(LeafSystem):
    """Sends what its inputs hold, at fixed times or whenever it is asked to publish.

    .. pydrake_system::

        name: Sender
        input_ports:
        - those of the feed, such as volume or estimate

    Parameters
    ----------
    outlet
        Connections to send to.
    feed
        Inputs, and the messages that are made of them, such as `volume_feed`.
    period, offset
        Period and offset of the times at which it sends, in s: a moment after the tracker's.
    """

    def __init__(self, *, outlet: Link, feed: Feed, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._outlet, self._feed = outlet, feed
        declare_inputs(self, **feed.inputs)
        self._start()
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        """Forget the values of an earlier run."""
        self._newest = -float("inf")

    def _publish(self, context: Context) -> None:
        feed, time = self._feed, context.get_time()
        values = {name: evaluate(self, context, name, kind) for name, kind in feed.inputs.items()}
        if feed.stamp is not None:
            stamp = feed.stamp(**values)
            if stamp is None or stamp <= self._newest:
                return
            self._newest = stamp
        self._outlet.send(feed.items(time, **values), topic=feed.topic, keep=feed.keep)
