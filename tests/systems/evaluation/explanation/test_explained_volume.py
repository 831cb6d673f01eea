from dataclasses import replace

import numpy as np
import pytest
from explanations import (
    NEEDLE,
    SCENE,
    K,
    empty_look,
    estimate,
    explained,
    look,
    predicted,
)
from pydrake.math import RigidTransform, RollPitchYaw
from synthetic_logs import build_log

from sonoservo.systems.evaluation import read_explanations
from sonoservo.systems.evaluation.explanation.explained_volume import (
    FOLDER,
    clear_explanations,
    deciding_attempt,
    explain_volume,
    find_occasion,
    imaged_needle,
    write_explanation,
)
from sonoservo.systems.evaluation.log import columns
from sonoservo.systems.signals import LocalizationExplanation, NotFound, TrackingMode

COASTING, SEARCHING = TrackingMode.COASTING, TrackingMode.SEARCHING


def test_all_that_was_looked_at_is_kept():
    volume = SCENE.volume(0, lambda t: NEEDLE)
    account = replace(look(volume, predicted()), innovation=1.5, gate=5.3)
    (attempt,) = account.attempts
    before, after = estimate(-0.3, COASTING), estimate(volume.time)
    kept = explain_volume(volume, account, before=before, after=after, occasion="coasting to")
    wanted = {
        "mode_before": "coasting", "mode_after": "tracking", "attempt_reasons": [""],
        "innovation": 1.5, "gate": 5.3, "volume_time": volume.time, "contrast": 3.0,
        "predicted": NEEDLE, "measured": account.measurement.curve.control_points,
        "before": before.curve.control_points, "region_radius": attempt.region.radius,
        "measured_tip_covariance": account.measurement.covariance[3:, 3:],
        "inliers": attempt.inliers, "profile_level": attempt.profile.level,
        "start": attempt.extent.start, "tip": attempt.extent.tip,
    }  # fmt: skip
    for name, value in wanted.items():
        np.testing.assert_array_equal(getattr(kept, name), value, err_msg=name)
    np.testing.assert_allclose(kept.candidates, attempt.candidates, atol=1e-8)
    # The slices go through the measured needle, which is bright in both.
    assert kept.sliced == "measured"
    for name in ("beam", "cross"):
        picture, size = getattr(kept, f"{name}_slice"), getattr(kept, f"{name}_size")
        assert picture.dtype == np.uint8
        np.testing.assert_allclose(size / picture.shape[::-1], 0.5e-3, rtol=0.02)
        middle = kept.to_probe(account.measurement.curve.position([0.6]))[0]
        X_PS = RigidTransform(getattr(kept, f"{name}_X_PS"))
        x, y, off = X_PS.inverse().multiply(middle)
        assert abs(off) < 1e-4
        column, row = ((np.array([x, y]) / size + 0.5) * picture.shape[::-1]).astype(int)
        assert picture[row, column] > np.median(picture[picture > 0]) + 60


def test_the_search_that_decided_is_the_one_that_found_the_needle_or_came_furthest():
    found = look(SCENE.volume(0, lambda t: NEEDLE), predicted()).attempts[0]
    failed = look(SCENE.volume(1), predicted()).attempts[0]
    bare = replace(failed, candidates=None, weights=None, inliers=None, profile=None, extent=None)
    given = {"volume_time": 0.0, "prediction": predicted()}
    account = LocalizationExplanation(
        **given, attempts=(bare, found, failed), measurement=found.measurement
    )
    assert deciding_attempt(account) is found
    nothing = NotFound("no needle in the whole volume")
    account = replace(account, attempts=(bare, failed, bare), measurement=nothing)
    assert deciding_attempt(account) is failed
    assert deciding_attempt(replace(account, attempts=())) is None


def test_files_hold_what_was_kept_in_order(tmp_path):
    late, early = explained(number=40), explained(found=False)
    for each in (late, early):
        write_explanation(tmp_path, each)
    assert {path.name for path in (tmp_path / FOLDER).iterdir()} == {
        "0000.000s.npz",
        "0012.120s.npz",
    }
    read = read_explanations(tmp_path)
    assert [float(each.volume_time) for each in read] == [0.0, pytest.approx(12.12)]
    for name in columns(type(late)):
        np.testing.assert_array_equal(getattr(read[1], name), getattr(late, name), err_msg=name)
    points = np.random.default_rng(0).uniform([-0.01, 0.03, -0.01], [0.01, 0.05, 0.01], (5, 3))
    np.testing.assert_array_equal(read[1].to_probe(points), late.to_probe(points))
    assert read[1].motion.geometry == SCENE.volume(0).motion.geometry


def test_only_files_of_explanations_are_cleared(tmp_path):
    write_explanation(tmp_path, explained())
    (tmp_path / FOLDER / "notes.txt").write_text("mine")
    (tmp_path / "log.npz").write_bytes(b"")
    clear_explanations(tmp_path)
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["notes.txt"]
    (tmp_path / FOLDER / "notes.txt").unlink()
    clear_explanations(tmp_path)
    clear_explanations(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["log.npz"]


@pytest.mark.parametrize(
    ("before", "after", "detected", "occasion"),
    [
        (None, estimate(1.0), False, "first volume"),
        (None, estimate(1.0, SEARCHING), False, ""),
        (estimate(0.7, SEARCHING), estimate(1.0, SEARCHING), True, "first detection"),
        (estimate(0.7), estimate(1.0, COASTING), False, "tracking to coasting"),
        (estimate(0.7), estimate(1.0), False, ""),
        # It moves as expected, 6 mm in 0.3 s; or it was expected to.
        (estimate(0.7, speed=0.02), estimate(1.0, tip=NEEDLE[1] + [6e-3, 0, 0]), False, ""),
        (
            estimate(0.7, speed=0.02),
            estimate(1.0),
            False,
            "the tip is 6.0 mm from where it was expected",
        ),
    ],
)
def test_occasions(before, after, detected, occasion):
    assert find_occasion(before, after, detected=detected, max_jump=3e-3) == occasion


def test_the_true_needle_is_shown_where_each_of_its_points_was_acquired():
    """The needle and the probe move; the volume shows the needle where its frames met it."""
    X_WP = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.4, 0.5, 0.6])
    still = SCENE.volume(2, X_WP=X_WP)
    poses = still.motion.X_WP.copy()
    poses[:, :3, 3] += np.linspace(-2e-3, 2e-3, len(poses))[:, np.newaxis]
    motion = replace(still.motion, X_WP=poses)
    volume = replace(still, motion=motion)
    nothing = NotFound("")
    kept = explain_volume(
        volume,
        empty_look(volume.time, nothing),
        before=None,
        after=estimate(volume.time, SEARCHING),
        occasion="x",
    )
    time = np.arange(0, 1.2, 1 / 32)
    length = 10e-3 + 20e-3 * time
    ends = X_WP.multiply(NEEDLE[0]), X_WP.rotation() @ K
    shares = np.linspace(0, 1, 9)
    points = ends[0] + (length[:, np.newaxis] * shares)[..., np.newaxis] * ends[1]
    log = build_log(len(time), 0, time=time, needle_points=points)
    shown = imaged_needle(log, kept)
    assert shown.shape == (33, 3)
    p_W, acquired = motion.to_world(shown)
    share = np.linspace(0, 1, 33)
    reach = (10e-3 + 20e-3 * acquired) * share
    np.testing.assert_allclose(p_W, ends[0] + reach[:, np.newaxis] * ends[1], atol=3e-5)
    outside = build_log(len(time), 0, time=time)
    assert imaged_needle(outside, kept).shape == (0, 3)
