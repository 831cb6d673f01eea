from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter

from sonoservo.systems.shape import CrossSectionLocalizer, CrossSectionParameters
from sonoservo.systems.shape.cross_section import (
    find_again,
    find_first,
    image_mean,
    start_at,
    variance_image,
)
from sonoservo.systems.signals import (
    CrossSectionTrack,
    ImageClick,
    ImageSlice,
    NeedleShape,
    NotFound,
)

PARAMETERS = CrossSectionParameters()
SPACING, ORIGIN = 0.2e-3, np.array([-0.02, 0.005])
RADIUS = PARAMETERS.needle_radius


def picture(axis=None, *, seed=0, level_db=30.0, more=(), depth=0.0, time=0.0, shape=(201, 201)):
    """Speckle, and the echo of a needle with this axis (x, y): front wall and reverberations."""
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, *shape))
    speckle = np.array([gaussian_filter(each, [1.6, 0.5]) for each in parts])
    speckle /= np.sqrt(np.mean(np.sum(speckle**2, axis=0)))
    amplitude = speckle[0] + 1j * speckle[1]
    x, y = (ORIGIN[a] + SPACING * np.arange(shape[a]) for a in range(2))
    echoes = [(at, decibels) for at, decibels in more]
    if axis is not None:
        front = np.subtract(axis, [0, RADIUS])
        echoes += [(front + np.array([0, 0.87e-3 * n]), level_db - 8 * n) for n in range(4)]
    for at, decibels in echoes:
        blur = np.exp(
            -0.5 * ((x[:, None] - at[0]) / 0.37e-3) ** 2 - 0.5 * ((y - at[1]) / 0.1e-3) ** 2
        )
        amplitude = amplitude + 10 ** (decibels / 20) * blur
    grey = 80 + 255 / 60 * 20 * np.log10(np.abs(amplitude) + 1e-6)
    X_WP = RigidTransform([0, 0, depth])
    return ImageSlice(
        np.clip(np.rint(grey), 1, 255).astype(np.uint8), ORIGIN, [SPACING] * 2, X_WP, time
    )


def near(place, parameters=PARAMETERS):
    """A place at which a cross-section is expected, as without a predicted shape."""
    return np.asarray(place), parameters.expected_std


def test_variance_image_is_equation_1_and_keeps_the_sign_if_asked():
    image = np.array([[10, 20], [40, 50]], np.uint8)
    assert variance_image(image, 30.0).tolist() == [[400, 100], [100, 400]]
    assert variance_image(image, 30.0, deviations="signed").tolist() == [[-400, -100], [100, 400]]
    assert variance_image(image, 30.0, deviations="brighter").tolist() == [[0, 0], [100, 400]]


def test_mean_leaves_out_what_lies_outside_the_sector():
    image = picture()
    array = image.intensities.copy()
    array[:50] = 0
    masked = ImageSlice(array, ORIGIN, [SPACING] * 2, RigidTransform(), 0.0)
    assert image_mean(masked) == pytest.approx(array[50:].mean())


@pytest.mark.parametrize("level_db", [20.0, 40.0])
def test_a_cross_section_is_found_to_a_fraction_of_a_pixel(level_db):
    rng = np.random.default_rng(5)
    errors = []
    for seed in range(8):
        axis = np.array([0.0, 0.025]) + rng.uniform(-1e-3, 1e-3, 2)
        found = start_at(picture(axis, seed=seed, level_db=level_db), axis, PARAMETERS)
        errors.append(found.centre - axis)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    # Noise of the vertex: about the echo's width over the ratio of amplitudes.
    assert rms[0] < 1.3e-3 * 10 ** (-level_db / 20) + 0.01e-3
    assert rms[1] < 0.3e-3 * 10 ** (-level_db / 20) + 0.005e-3


def test_following_does_not_drift():
    axis = np.array([0.0, 0.025])
    last = start_at(picture(axis), axis, PARAMETERS)
    for number in range(1, 60):
        axis = axis + np.array([0.06e-3, 0.03e-3])
        image = picture(axis, seed=number, level_db=32)
        last = find_again(image, last, near(last.centre), PARAMETERS)
        assert np.linalg.norm(last.centre - axis) < 0.2e-3


def test_a_brighter_echo_beside_does_not_take_over():
    axis, other = np.array([0.0, 0.025]), np.array([2.5e-3, 0.0255])
    image = picture(axis, level_db=28)
    last = start_at(image, axis, PARAMETERS)
    beside = picture(axis, seed=1, level_db=28, more=[(other, 34)])
    found = find_again(beside, last, near(axis), PARAMETERS)
    assert np.allclose(found.centre, axis, atol=0.1e-3)


def test_a_needle_that_looks_more_like_the_last_does_not_take_over():
    axis, other = np.array([0.0, 0.025]), np.array([-3e-3, 0.025])
    last = start_at(picture(axis), axis, PARAMETERS)
    # The other has the last one's echo; the needle's own has faded.
    swapped = picture(other, more=[(axis - np.array([0, RADIUS]), 24)])
    found = find_again(swapped, last, near(axis), PARAMETERS)
    assert np.allclose(found.centre, axis, atol=0.15e-3)
    # Where nothing tells the place, it is the other that matches best.
    anywhere = find_again(swapped, last, (axis, 0.1), PARAMETERS)
    assert np.allclose(anywhere.centre, other, atol=0.15e-3)


@pytest.mark.parametrize(
    ("image", "expected", "reason"),
    [
        (picture(seed=3), [0.0, 0.025], "above the tissue|correlation"),
        (picture([0.0, 0.025]), [-0.04, 0.025], "left the image"),
        (picture([-0.0195, 0.025]), [-0.0175, 0.025], "edge|correlation|above"),
    ],
)
def test_a_needle_that_is_not_there_is_not_found(image, expected, reason):
    axis = np.array([0.0, 0.025])
    last = start_at(picture(axis), axis, PARAMETERS)
    found = find_again(image, last, near(expected), PARAMETERS)
    assert isinstance(found, NotFound)
    assert any(each in found.reason for each in reason.split("|"))


def test_the_first_is_found_by_what_stays_or_where_a_person_points():
    axis, fibre = np.array([0.002, 0.025]), np.array([-0.008, 0.03])
    images = [
        picture(axis, seed=number, more=[(fibre, 45)] if number < 2 else [], time=number)
        for number in range(4)
    ]
    assert "being compared" in find_first(images[:3], PARAMETERS).reason
    assert np.allclose(find_first(images, PARAMETERS).centre, axis, atol=0.1e-3)
    pointed = CrossSectionParameters(start=list(axis + 0.3e-3))
    assert np.allclose(find_first(images[:1], pointed).centre, axis, atol=0.1e-3)


# A needle that goes 6 mm aside in 40 mm.
SLANTED = NeedleShape(
    parameters=[[1e4, np.arctan(0.15), 0.0]], origins=[[0.0, 0.025]], weights=[1.0],
    origin_variance=0.0, rotations=(), depth=0.1, observed=0.02, X_WI=RigidTransform(),
    time=0.0,
)  # fmt: skip


def localize(track, image, shape=None, click=None):
    localizer = CrossSectionLocalizer(parameters=PARAMETERS)
    context = localizer.CreateDefaultContext()
    inputs = {"slice": image, "cross_section_track": track, "shape": shape, "click": click}
    for name, value in inputs.items():
        if value is not None:
            localizer.GetInputPort(name).FixValue(context, Value[object](value))
    return localizer.GetOutputPort("cross_section").Eval(context)


def test_localizer_finds_again_what_was_found_and_looks_at_a_slice_once():
    first = picture([0.0, 0.025], time=0.0)
    found = start_at(first, [0.0, 0.025], PARAMETERS)
    track = CrossSectionTrack(found, first.time, found)
    assert localize(track, first) is found
    assert localize(track, NotFound("no slice")) is found
    moved = localize(track, picture([0.5e-3, 0.025], seed=1, time=1.0))
    assert np.allclose(moved.centre, [0.5e-3, 0.025], atol=0.1e-3)
    # Out of reach of the last region of interest, but on the predicted shape.
    far = picture([6e-3, 0.025], seed=2, depth=0.04, time=2.0)
    for early in (None, replace(SLANTED, observed=9e-3)):
        assert not localize(track, far, early)
    assert np.allclose(localize(track, far, SLANTED).centre, [6e-3, 0.025], atol=0.1e-3)


def test_the_printed_position_is_the_match_s_and_the_click_is_taken_as_it_is():
    printed = CrossSectionParameters(position="match", deviations="both", min_correlation=0.0)
    axis, click = np.array([0.0, 0.025]), np.array([0.4e-3, 0.0253])
    first = start_at(picture(axis), click, printed)
    np.testing.assert_array_equal(first.centre, click)
    aside = np.array([0.6e-3, 0.4e-3])
    image, expected = picture(axis + aside, seed=1), near(click + np.array([0.2e-3, 0]))
    moved = find_again(image, first, expected, printed)
    # Between pixels, from the click's own place and not from that at which the template was cut.
    np.testing.assert_allclose(moved.centre - click, aside, atol=0.35 * SPACING)
    # It follows whatever resembles the template most, even where there is no needle.
    assert find_again(picture(seed=2), first, near(click), printed)


def test_a_click_off_the_needle_by_three_deviations_still_finds_it():
    axis = np.array([0.0, 0.025])
    for turn in np.arange(4) * np.pi / 2:
        away = 1.5e-3 * np.array([np.cos(turn), np.sin(turn)])
        parameters = CrossSectionParameters(start=list(axis + away))
        found = find_first([picture(axis, seed=4)], parameters)
        np.testing.assert_allclose(found.centre, axis, atol=0.12e-3)


def test_the_localizer_waits_for_a_click():
    axis = np.array([0.0, 0.025])
    waiting, found = (
        localize(CrossSectionTrack(), picture(axis), click=click)
        for click in (NotFound("no click"), ImageClick(axis + 0.5e-3))
    )
    assert "nobody has clicked" in waiting.reason
    np.testing.assert_allclose(found.centre, axis, atol=0.12e-3)


@pytest.mark.parametrize(("field", "value"), [("search", [0.0, 1e-3]), ("start", [0.0])])
def test_bad_parameters_are_named(field, value):
    with pytest.raises(ValueError, match=field):
        CrossSectionParameters(**{field: value})
