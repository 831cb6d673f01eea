from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from pydrake.common.value import Value

from sonoservo.systems.evaluation import PictureRecorder, picture_planes
from sonoservo.systems.evaluation.reports import track_plots
from sonoservo.systems.signals import NeedleEstimate, TrackingMode


def test_a_long_run_keeps_fewer_pictures_of_its_beginning(make_volume, monkeypatch):
    monkeypatch.setattr(track_plots, "picture_planes", lambda volume, mode, curve: volume)
    recorder = PictureRecorder(period=0.1)
    context = recorder.CreateDefaultContext()
    estimate = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
    recorder.GetInputPort("estimate").FixValue(context, Value[object](estimate))
    blank = make_volume(lambda p_P: np.zeros(p_P.shape[:-1]))
    for number in range(1500):
        volume = replace(blank, time=float(number))
        recorder.GetInputPort("volume").FixValue(context, Value[object](volume))
        recorder.ForcedPublish(context)
        recorder.ForcedPublish(context)  # it is no new volume
    times = [each.time for each in recorder.pictures(context)]
    assert 200 < len(times) <= 400
    assert (times[0], times[-1]) == (0, 1499)
    gaps = np.diff(times)
    assert (gaps > 0).all()
    assert (gaps[-150:] == 1).all()


def test_a_slice_along_the_beam_is_drawn_over_depth(make_volume):
    volume = make_volume(lambda p_P: np.zeros(p_P.shape[:-1]))
    picture, _ = picture_planes(volume, TrackingMode.SEARCHING, None).planes
    axes = Figure().subplots()
    picture.draw(axes)
    assert picture.down == "depth (mm)"
    np.testing.assert_allclose(axes.get_ylim(), 1e3 * np.array([volume.upper[1], volume.origin[1]]))
