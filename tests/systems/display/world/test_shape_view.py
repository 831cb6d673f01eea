import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.world.rod import Rod
from sonoservo.systems.display.world.shape_view import ShapeView
from sonoservo.systems.evaluation.reports.report import save_replay
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


def shape(deviation):
    return NeedleShape(
        parameters=[[1.0, 0.02, 0.0]], origins=[[0.0, 0.03]], weights=[1.0],
        origin_variance=deviation**2, rotations=(), depth=0.1, observed=0.02,
        X_WI=RigidTransform(), time=0.0,
    )  # fmt: skip


def publish(view, time, **values):
    context = view.CreateDefaultContext()
    context.SetTime(time)
    view.GetInputPort("X_WT").FixValue(context, Value(RigidTransform()))
    for name, value in values.items():
        view.GetInputPort(name).FixValue(context, Value[object](value))
    view.ForcedPublish(context)


class Recorder:
    """Notes what a rod is told to show."""

    def __init__(self, monkeypatch):
        self.calls = []
        show = Rod.show

        def noting(rod, polyline, time, radii=None):
            self.calls.append((np.array(polyline), radii))
            show(rod, polyline, time, radii)

        monkeypatch.setattr(Rod, "show", noting)


GEOMETRY = sweep_geometry(
    load_transducer("4dl14_5_38"), ImagingParameters(transmit_frequency=7.5e6, frames=1)
)
VIEW = {"tissue_size": [0.2, 0.1, 0.1], "depth": 0.1, "geometry": GEOMETRY}


def test_tube_is_as_wide_as_95_percent_and_follows_the_predicted_shape(meshcat, monkeypatch):
    view = ShapeView(meshcat=meshcat, **VIEW, period=1, offset=0)
    recorder = Recorder(monkeypatch)
    needle = Needle([[0, 0, 0], [0, 0, 0.02]], 6e-4)
    image = ImageSlice(
        np.full((50, 60), 90, np.uint8), [0.0, 0.0], [1e-3, 1e-3], RigidTransform(), 0.0
    )
    publish(
        view, 1.0, needle=needle, slice=image, shape=shape(1e-3), cross_section=NotFound("none")
    )
    ((polyline, radii),) = (each for each in recorder.calls if each[1] is not None)
    assert np.allclose(radii, 1e-3 * RADIUS_95 + 1.5e-3)
    assert np.allclose(polyline[-1], shape(1e-3).tip)
    assert np.allclose(polyline[0], [0, 0.03, 0])
    assert all(meshcat.HasPath(path) for path in ("/probe", "/predicted", "/slice/live"))


def test_nothing_is_predicted_while_there_is_no_shape(meshcat, monkeypatch):
    view = ShapeView(meshcat=meshcat, **VIEW, period=1, offset=0)
    recorder = Recorder(monkeypatch)
    missing = NotFound("no slice yet")
    publish(
        view, 0.5, needle=Needle(np.zeros((0, 3)), 6e-4), slice=missing, shape=missing,
        cross_section=missing,
    )  # fmt: skip
    assert recorder.calls == []


def test_replay_is_one_page(meshcat, tmp_path):
    assert save_replay(meshcat, tmp_path / "replay.html").stat().st_size > 1000
