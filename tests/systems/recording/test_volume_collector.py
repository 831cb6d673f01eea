from dataclasses import replace

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from sonoservo.systems.recording import VolumeCollector
from sonoservo.systems.signals import NotFound


def test_every_new_volume_is_kept_once(make_volume):
    collector = VolumeCollector(period=0.1)
    context = collector.CreateDefaultContext()
    blank = make_volume(lambda p_P: np.zeros(p_P.shape[:-1]))
    volumes = [replace(blank, time=float(number)) for number in range(3)]
    for value in (NotFound("none yet"), *volumes):
        collector.GetInputPort("volume").FixValue(context, Value[object](value))
        collector.ForcedPublish(context)
        collector.ForcedPublish(context)  # it is no new volume
    assert collector.volumes(context) == volumes
    Simulator(collector, context).Initialize()
    assert collector.volumes(context) == volumes[-1:]
