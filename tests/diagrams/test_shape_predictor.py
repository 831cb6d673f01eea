import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.diagrams import MakeShapePredictor
from sonoservo.systems.shape import CrossSectionParameters
from sonoservo.systems.signals import CrossSection, ImageSlice, NeedleShape, NotFound

SPACING, ORIGIN = 0.2e-3, np.array([-0.02, 0.005])
RADIUS = CrossSectionParameters().needle_radius


def picture(axis, *, seed=0, fibre=None, depth=0.0, time=0.0):
    """Grainy tissue, and the echo of a needle with this axis (x, y), if it is there."""
    shape = (201, 201)
    grey = np.random.default_rng(seed).normal(80, 12, shape)
    x, y = (ORIGIN[a] + SPACING * np.arange(shape[a]) for a in range(2))
    for at, height in ((axis, 130), (fibre, 160)):
        if at is not None:
            at = np.subtract(at, [0, RADIUS])
            blur = -0.5 * ((x[:, None] - at[0]) / 0.37e-3) ** 2 - 0.5 * ((y - at[1]) / 0.15e-3) ** 2
            grey = grey + height * np.exp(blur)
    X_WP = RigidTransform([0, 0, depth])
    return ImageSlice(
        np.clip(grey, 1, 255).astype(np.uint8), ORIGIN, [SPACING] * 2, X_WP, float(time)
    )


def show(predictor, context, image):
    predictor.GetInputPort("slice").FixValue(context, Value[object](image))
    found = predictor.GetOutputPort("cross_section").Eval(context)
    predictor.ExecuteForcedEvents(context)
    # After its event, the same slice gives the same cross-section.
    assert predictor.GetOutputPort("cross_section").Eval(context) is found
    return found


def test_it_starts_with_what_lasts_and_follows():
    predictor = MakeShapePredictor(period=1.0)
    context = predictor.CreateDefaultContext()
    axis, fibre = np.array([0.002, 0.025]), np.array([-0.008, 0.03])
    for number in range(12):
        depth = 0.5e-3 * number
        image = picture(axis, seed=number, fibre=fibre if number < 2 else None, depth=depth,
                        time=number)  # fmt: skip
        found = show(predictor, context, image)
        shape = predictor.GetOutputPort("shape").Eval(context)
        if number < 3:
            assert isinstance(found, NotFound)
            assert isinstance(shape, NotFound)
        else:
            assert np.allclose(found.position, [*axis, depth], atol=0.1e-3)
            assert shape.time == number
    assert isinstance(found, CrossSection)


def test_it_follows_the_predicted_shape_while_the_needle_is_not_seen():
    # A needle that goes 0.15 m a metre aside: the last region of interest does not reach it.
    localizer = CrossSectionParameters(start=[0.0, 0.025], follow_shape_from=0.01)
    predictor = MakeShapePredictor(localizer=localizer, period=1.0)
    context = predictor.CreateDefaultContext()

    def axis(depth):
        return np.array([0.15 * depth, 0.025])

    for number in range(21):
        depth = 1e-3 * number
        assert show(predictor, context, picture(axis(depth), seed=number, depth=depth, time=number))
    for number in range(21, 60):
        depth = 1e-3 * number
        assert not show(predictor, context, picture(None, seed=number, depth=depth, time=number))
    found = show(predictor, context, picture(axis(0.06), seed=60, depth=0.06, time=60))
    assert np.allclose(found.centre, axis(0.06), atol=0.1e-3)
    shape = predictor.GetOutputPort("shape").Eval(context)
    assert isinstance(shape, NeedleShape)
    assert shape.observed == pytest.approx(0.06)
