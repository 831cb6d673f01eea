from dataclasses import replace

import numpy as np
import pytest
from explanations import NEEDLE, SCENE, empty_look, estimate, explained, predicted
from matplotlib.patches import Ellipse

from sonoservo.systems.evaluation import plot_explanation
from sonoservo.systems.evaluation.explanation.explained_volume import explain_volume
from sonoservo.systems.evaluation.explanation.explanation_sheet import describe
from sonoservo.systems.signals import NotFound, TrackingMode


def line(axes, label):
    """(m, 2) data of the line of a label."""
    (found,) = [each for each in axes.lines if each.get_label() == label]
    return np.column_stack(found.get_data()).astype(float)


def labels(axes):
    return set(axes.get_legend_handles_labels()[1])


@pytest.fixture(scope="module")
def found():
    return explained(occasion="first detection")


@pytest.fixture(scope="module")
def failed():
    return explained(found=False)


def searched():
    volume = SCENE.volume(0)
    look = empty_look(volume.time, NotFound("no needle has been detected"))
    after = estimate(volume.time, TrackingMode.SEARCHING)
    return explain_volume(volume, look, before=None, after=after, occasion="before")


def draw(volume, **options):
    figure = plot_explanation(volume, **options)
    beam, profile, cross, gate, *_ = figure.axes
    return figure, beam, cross, profile, gate


def test_slices_show_the_needle_in_mm(found):
    _, beam, cross, _, _ = draw(found, needle=found.to_probe(NEEDLE))
    truth = line(beam, "true needle")
    # Depth in P, and the distance from the measured tip; 30 mm long, seen from its side.
    depth = 1e3 * found.to_probe(NEEDLE)[:, 1]
    np.testing.assert_allclose(truth[:, 1], depth)
    assert abs(truth[-1, 0]) < 2
    np.testing.assert_allclose(np.linalg.norm(np.diff(truth, axis=0)), 30, atol=0.3)
    measured = line(beam, "measured needle")
    assert np.linalg.norm(measured[-1] - truth[-1]) < 2
    np.testing.assert_allclose(measured[-1, 0], 0, atol=1e-9)
    np.testing.assert_allclose(line(cross, "measured needle")[-1], 0, atol=1e-9)
    assert beam.get_ylabel() == "depth, mm"
    assert beam.get_xlabel() == "along the measured needle, mm from its tip"
    for axes in (beam, cross):
        left, right, bottom, top = axes.images[0].get_extent()
        assert left < -25 < 0 < right
        assert bottom > top  # the probe is at the top
        assert axes.get_xlim()[0] >= left
    assert labels(beam) >= {
        "region searched",
        "candidates",
        "consensus inliers",
        "fitted axis",
        "predicted needle",
        "measured needle",
        "measured tip, 95 %",
        "true needle",
    }


def test_the_ellipse_has_the_tip_with_95_percent(found):
    _, beam, _, _, _ = draw(found)
    (ellipse,) = [each for each in beam.patches if isinstance(each, Ellipse)]
    X_PS = found.beam_X_PS
    R_SW = X_PS[:3, :2].T @ found.X_WP[:3, :3].T
    covariance = 1e6 * R_SW @ found.measured_tip_covariance @ R_SW.T
    points = np.random.default_rng(0).multivariate_normal(ellipse.center, covariance, 20_000)
    angle = np.radians(ellipse.angle)
    turned = (points - ellipse.center) @ [
        [np.cos(angle), -np.sin(angle)],
        [np.sin(angle), np.cos(angle)],
    ]
    inside = np.sum((turned / [ellipse.width / 2, ellipse.height / 2]) ** 2, axis=1) < 1
    assert inside.mean() == pytest.approx(0.95, abs=0.01)


def test_profile_against_distance(found):
    _, _, _, profile, _ = draw(found, needle=found.to_probe(NEEDLE))
    level, threshold = line(profile, "level"), line(profile, "threshold: 3 dB over it")
    background = line(profile, "background")
    np.testing.assert_allclose(level[:, 0], 1e3 * (found.profile_a - found.profile_a[0]))
    seen = found.profile_seen
    np.testing.assert_array_equal(level[seen, 1], found.profile_level[seen])
    assert np.isnan(level[~seen, 1]).all()
    np.testing.assert_allclose(threshold[seen, 1], background[seen, 1] + 3)
    tip = line(profile, "tip found")[0, 0]
    assert tip == pytest.approx(1e3 * (found.tip - found.profile_a[0]))
    assert line(profile, "true tip")[0, 0] == pytest.approx(tip, abs=1.5)
    assert line(profile, "tip predicted")[0, 0] == pytest.approx(tip, abs=1.5)
    assert {"unseen", "taken for the needle"} <= labels(profile)
    assert profile.get_xlabel() == "distance along the axis, mm"


def test_what_is_not_there_is_said_and_the_reason_stands_above(found, failed):
    figure, beam, _, _, gate = draw(failed)
    assert "measured needle" not in labels(beam)
    assert beam.get_title(loc="left") == "Slice along the beam, through the predicted needle"
    assert "gate" not in str(labels(gate))
    assert figure.get_suptitle() == describe(failed)
    assert describe(failed).startswith("0.00 s, tracking → coasting: ")
    first, second = describe(found, 2.34e-3).splitlines()
    assert first == "0.00 s, tracking: the needle was confirmed"
    facts = "first detection", "estimated tip 2.3 mm from the true one"
    assert second == "; ".join([*facts, "its tip is seen with a probability of 100 %"])
    _, beam, cross, _, _ = draw(explained(found=False, prediction=predicted(shift=1.0)))
    texts = [text.get_text() for axes in (beam, cross) for text in axes.texts]
    assert "the slice misses the volume" in texts
    _, beam, cross, profile, _ = draw(searched())
    assert beam.get_title(loc="left") == "Slice at elevation 0"
    assert (cross.get_xlabel(), cross.get_ylabel()) == ("elevation, mm", "depth, mm")
    assert profile.texts[0].get_text() == "no axis was found"


def test_lines_followed_are_drawn_while_nothing_is_measured():
    history = np.array([[9.0, np.nan, -2.0], [8.0, 7.0, -1.0]])
    kept = replace(
        searched(),
        sliced=np.array("line"),
        line_numbers=np.array([7.0, 3.0]),
        line_probabilities=np.array([0.97, 0.2]),
        line_classes=np.array([[0.9, 0.1, 0, 0, 0], [0.1, 0.2, 0.3, 0.4, 0]]),
        line_looks=np.array([1.5, -3.0]),
        line_ends=np.array([NEEDLE, np.add(NEEDLE, [0, 0, 5e-3])]),
        history_times=np.array([-0.3, 0.0]),
        history_a=np.array([0.0, 2e-3, 4e-3]),
        history=history,
    )
    _, beam, _, classes, shown = draw(kept, needle=kept.to_probe(NEEDLE))
    assert beam.get_title(loc="left").endswith("through the line most like a needle")
    names = [text.get_text() for text in classes.get_yticklabels()]
    assert names[0] == "line 7: needle 97 %\nlooks: log odds +1.5"
    widths = [[bar.get_width() for bar in bars] for bars in classes.containers]
    np.testing.assert_allclose(np.transpose(widths), kept.line_classes)
    np.testing.assert_allclose(shown.collections[0].get_array().filled(np.nan), history.T)
    truth = line(shown, "true tip, 0 mm beside the line")
    np.testing.assert_allclose(truth, [[0, 30]], atol=0.1)
    _, *_, shown = draw(replace(kept, history_times=np.zeros(1), history=history[:1]))
    assert np.ptp(shown.collections[0].get_coordinates()[..., 0]) > 0.3  # wide enough to be seen
    _, *_, shown = draw(replace(kept, history=np.full_like(history, np.nan)))
    assert shown.get_title(loc="left") == "Measurement against prediction"
