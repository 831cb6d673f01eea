"""Leaf system that detects a needle which enters the field of view, as published."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.diagrams.papers.chatelain2013.method.detection import (
    PublishedDetectionParameters,
    detect_as_published,
)
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.volume import Volume


class InsertionDetector(LeafSystem):
    """Detects a needle's insertion from the difference of two volumes; see `detect_as_published`.

    .. pydrake_system::

        name: InsertionDetector
        input_ports:
        - volume
        - previous_volume
        output_ports:
        - detection

    The system has no state. The output is an `InsertionDetection`, or a `NotFound` with the reason.
    """

    def __init__(self, *, parameters: PublishedDetectionParameters | None = None) -> None:
        super().__init__()
        self._parameters = parameters or PublishedDetectionParameters()
        declare_inputs(self, volume=(Volume, NotFound), previous_volume=(Volume, NotFound))
        declare_output(self, "detection", (InsertionDetection, NotFound), self._calc_detection)

    def _calc_detection(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        previous = evaluate(self, context, "previous_volume", (Volume, NotFound))
        if not isinstance(volume, Volume):
            output.set_value(volume)
        elif not isinstance(previous, Volume):
            output.set_value(previous)
        else:
            output.set_value(detect_as_published(volume, previous, self._parameters))
