import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.systems.shape.cross_section_memory import CrossSectionMemory, remembered
from sonoservo.systems.signals.cross_section import CrossSection, CrossSectionTrack
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound


def image(time):
    return ImageSlice(np.zeros((4, 4), np.uint8), [0.0, 0.0], [1e-3, 1e-3], RigidTransform(), time)


def cross_section(time):
    return CrossSection(np.zeros(3), np.eye(4), time, 0.9, np.zeros(2), np.zeros((3, 3)))


def test_slices_before_the_start_are_kept_until_an_attempt():
    track, missing = CrossSectionTrack(), NotFound("not yet")
    counts = []
    for time in range(5):
        track = remembered(track, image(float(time)), missing, start_slices=3)
        counts.append(len(track.images))
    # The third slice is for the attempt; the next one begins anew.
    assert counts == [1, 2, 0, 1, 2]
    assert track.found is missing
    assert track.last is None
    assert remembered(CrossSectionTrack(), image(0.0), missing, start_slices=1).images == ()


def test_leaf_takes_note_of_every_new_slice_at_its_events():
    memory = CrossSectionMemory(period=1.0)
    context = memory.CreateDefaultContext()
    port = memory.GetOutputPort("cross_section_track")
    assert not port.Eval(context).found
    first = cross_section(0.0)
    for picture, found, expected in (
        (NotFound("no slice"), NotFound("no slice yet"), None),
        (image(0.0), first, first),
        (image(0.0), cross_section(0.0), first),
        (image(1.0), NotFound("a shadow"), first),
    ):
        memory.GetInputPort("slice").FixValue(context, Value[object](picture))
        memory.GetInputPort("cross_section").FixValue(context, Value[object](found))
        before = port.Eval(context)
        memory.ExecuteForcedEvents(context)
        after = port.Eval(context)
        assert after.last is expected
        new = isinstance(picture, ImageSlice) and picture.time > before.time
        assert (after is before) == (not new)
    assert after.found.reason == "a shadow"
