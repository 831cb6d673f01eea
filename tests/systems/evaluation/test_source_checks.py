from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from sonoservo.systems.calibration.pose_errors import PoseErrors
from sonoservo.systems.evaluation.source_checks import (
    Check,
    Grade,
    check_across,
    check_contents,
    check_delay,
    check_errors,
    check_grid,
    check_matrices,
    check_motion,
    check_numbers,
    check_pixels,
    check_seen,
    check_times,
    check_volume,
    gravest,
    sweep_delay,
)
from sonoservo.systems.signals import NotFound, Volume
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame

RNG = np.random.default_rng(100)


def worst(findings):
    found = gravest(findings)
    return (found.check, found.text) if found else None


def moving(count=50):
    """Poses of a hand-held probe in mm: a slow sway."""
    matrices = np.tile(np.eye(4), (count, 1, 1))
    phase = np.linspace(0, 3, count)
    matrices[:, :3, 3] = np.column_stack([20 * np.sin(phase), 5 * phase, 100 + phase])
    matrices[:, :3, :3] = Rotation.from_rotvec(np.outer(0.1 * np.sin(phase), [1, 0, 0])).as_matrix()
    return matrices


def speckle(spacing, widths):
    """Log-compressed fully developed speckle whose point echo has widths (FWHM) in m."""
    shape = np.round([0.06, 0.05, 0.06] / np.array(spacing)).astype(int)
    sigma = np.array(widths) / 2.355 / spacing
    field = gaussian_filter(RNG.normal(size=shape), sigma) + 1j * gaussian_filter(
        RNG.normal(size=shape), sigma
    )
    grey = 255 / 60 * (20 * np.log10(np.abs(field) / np.abs(field).max() + 1e-9) + 60)
    return Volume(np.clip(grey, 1, 255).astype(np.uint8), np.zeros(3), spacing, RigidTransform(), 0)


def test_what_is_right_needs_nothing_and_is_told():
    findings = check_times(5.0 + 0.2 * np.arange(20))
    assert worst(findings) is None
    assert findings[0].text.startswith("5 volumes a second over 3.8 s")
    assert worst(check_matrices("ProbeToTracker", np.round(moving(), 4))) is None
    pixels = check_matrices("ImageToProbe", np.diag([0.2, 0.15, 0.2, 1]))
    assert worst(pixels) is None
    assert "0.2 x 0.15 mm" in pixels[0].text
    assert worst(check_motion("P", moving(), 0.05 * np.arange(50))) is None
    assert worst(check_grid(np.diag([1, 0.5, 1]), [60, 90, 40])) is None
    assert worst(check_grid(np.diag([1, 1, 1]), [60, 90, 40]))[0] is Check.SPACING
    assert worst(check_grid(np.diag([1, -0.5, 1]), [60, 90, 40]))[0] is Check.GRID


TIMES = 0.1 * np.arange(30)
SET_BACK = 0.6 * np.arange(12) - 3 * (np.arange(12) > 5)


@pytest.mark.parametrize(
    ("times", "check", "text"),
    [
        (np.delete(TIMES, [7, 8, 20]), Check.RATE, "the longest 0.3 s; missing volumes: about 3"),
        (TIMES + 0.05 * (np.arange(30) % 2), Check.RATE, "varies by 46 %"),
        ([*TIMES[:9], 0.8, 0.9], Check.CLOCK, "stands still 1 x, first from number 8 to 9; "),
        (np.zeros(5), Check.RATE, "no time stamp of 5 volumes advances"),
        (SET_BACK, Check.CLOCK, "back (by up to 2.4 s) 1 x, first from number 5 to 6; volumes"),
        (3e-4 * np.arange(4), Check.RATE, "3330 volumes a second, faster than any scanner"),
    ],
)
def test_times_that_need_something(times, check, text):
    findings = check_times(times)
    assert any(f.check is check and text in f.text and f.advice for f in findings), findings


@pytest.mark.parametrize(("step", "unit"), [(300.0, "ms"), (3e5, "us")])
def test_times_in_another_unit_are_told_with_the_rate_that_is_meant(step, unit):
    finding = check_times(step * np.arange(9))[-1]
    assert f"as if time stamps were in {unit}" in finding.text
    assert "--volume-rate 3.33" in finding.advice


REPEATS = TIMES - 0.1 * np.isin(np.arange(30), [5, 15])


@pytest.mark.parametrize("times", [SET_BACK, REPEATS])
def test_gaps_are_not_of_volumes_left_out_for_their_time(times):
    assert "gaps" not in str(check_times(times))


def test_gaps_that_interpolation_bridges_are_no_loss():
    times = np.delete(0.02 * np.arange(60), [20, *range(30, 50)])
    assert "gaps: 2," in str(check_times(times))
    assert "gaps: 1," in str(check_times(times, bridged=0.1))
    assert "gaps" not in str(check_times(times, bridged=0.5))


def test_jitter_is_not_of_volumes_left_out_for_their_time():
    findings = check_times(SET_BACK)
    assert {each.check for each in findings if each.grade} == {Check.CLOCK}
    assert findings[0].text.startswith("1.67 volumes a second over 3.6 s")


def test_frames_and_messages_may_be_faster_than_volumes():
    assert worst(check_times(1e-3 * np.arange(9), "frames")) is None
    assert "faster" in worst(check_times(1e-4 * np.arange(9), "messages of Probe"))[1]


@pytest.mark.parametrize(("spacing", "unit"), [(0.07, "cm"), (7e-4, "m")])
def test_a_spacing_in_another_unit_is_told(spacing, unit):
    (finding,) = check_grid(spacing * np.eye(3), [90, 60, 40])
    assert finding.check is Check.SPACING
    assert finding.advice == f"is the spacing in {unit}?"


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("ProbeToTracker", np.diag([1.2, 1.2, 1.2, 1]), "is no rotation: it scales by 1.2"),
        ("ProbeToTracker", np.diag([1, 1, -1, 1]), "is a reflection"),
        ("ImageToProbe", np.eye(4), "as if nobody had calibrated"),
        ("ProbeToTracker", np.full((4, 4), np.nan), "no matrix is valid"),
    ],
)
def test_matrices_that_are_none(name, change, text):
    check, found = worst(check_matrices(name, moving() @ change))
    assert check is Check.MATRIX
    assert text in found


def test_poses_that_do_not_move_as_a_probe():
    jumping, lost = moving(), moving()
    jumping[20, :3, 3] += 300
    lost[::5] = np.nan
    for poses, text in ((jumping, "jumps"), (lost, "marked invalid: 10 of 50")):
        check, found = worst(check_motion("P", poses, 0.05 * np.arange(50)))
        assert check is Check.MOTION
        assert text in found


def test_a_probe_that_is_held_needs_nothing_and_it_is_told_what_that_leaves_open():
    held = moving()[:1].repeat(50, axis=0), 0.05 * np.arange(50)
    probe, image = (check_motion(f"{name}ToTracker", *held) for name in ("Probe", "Image"))
    assert worst([*probe, *image]) is None
    assert "calibration cannot be judged" in probe[0].text
    assert "judged" not in image[0].text  # as of a calibration


SPACING, WIDTHS = np.array([6e-4, 3e-4, 7e-4]), np.array([1.6e-3, 0.6e-3, 2.2e-3])


@pytest.fixture(scope="module")
def volume():
    return speckle(SPACING, WIDTHS)


@pytest.fixture(scope="module")
def amplitude(volume):
    return 10 ** (volume.intensities.astype(np.float32) * 60 / 255 / 20)


def test_speckle_tells_right_spacing_unit_and_direction(volume):
    right = check_volume(volume)
    assert worst(right) is None
    text = next(each.text for each in right if each.check is Check.SPECKLE)
    assert float(text.split()[0]) == pytest.approx(0.6, rel=0.15)
    turned = check_volume(speckle(SPACING[[1, 0, 2]], WIDTHS[[1, 0, 2]]))
    assert "as if the sound ran there" in worst(turned)[1]
    assert "finest laterally" in worst(turned)[1]


def test_blank_and_hollow_volumes_are_told(volume):
    blank = Volume(0 * volume.intensities, np.zeros(3), volume.spacing, volume.X_WP, 0.0)
    assert "shows nothing" in worst(check_volume(blank))[1]
    unknown = replace(volume, mask=np.zeros(volume.intensities.shape, bool))
    assert "is NaN, infinite or stands for" in worst(check_volume(unknown))[1]
    lesser_bytes = np.random.default_rng(1).integers(0, 256, volume.intensities.shape)
    swapped = replace(volume, intensities=lesser_bytes.astype(np.uint8))
    assert "unrelated, as in no ultrasound" in worst(check_volume(swapped))[1]
    hollow = volume.intensities * (np.arange(volume.intensities.shape[0]) % 10 < 4)[:, None, None]
    hollow = Volume(hollow, np.zeros(3), volume.spacing, volume.X_WP, 0.0)
    assert "of what was seen is black" in worst(check_volume(hollow))[1]
    shown = np.broadcast_to(abs(np.arange(86) - 6) > 1, volume.intensities.shape)
    assert "3 whole slices" in str(check_volume(replace(volume, mask=shown.copy()))[1])


def test_a_sector_on_its_head_too_much_gain_and_holes_are_told(volume):
    i, j, _ = np.indices(volume.intensities.shape) / np.max(volume.intensities.shape)
    wider = np.abs(i - i.max() / 2) < 0.1 + 0.3 * j
    sector = replace(volume, mask=wider)
    assert worst(check_volume(sector)) is None
    assert "ran the other way" in worst(check_volume(replace(volume, mask=wider[:, ::-1])))[1]
    overdriven = replace(volume, intensities=np.minimum(volume.intensities, 150))
    assert "is as bright as can be" in worst(check_volume(overdriven))[1]
    assert check_seen({0: 0.41, 4: 0.40, 7: 0.42}) == []
    found = worst(check_seen({0: 0.41, 4: 0.2, 7: 0.42}))
    assert found[0] is Check.CONTENT
    assert "such as volume 4: 20 % instead of 41 %" in found[1]


def test_first_volumes_that_show_little_are_no_fault_as_the_probe_has_no_contact_yet():
    (found,) = check_seen({0: 0.15, 1: 0.2, 2: 0.41, 3: 0.42, 4: 0.40})
    assert found.grade is Grade.FINE
    assert "without contact does: 15 % of the box instead of 40 %" in found.text


def test_amplitudes_that_are_not_log_compressed_are_told(volume, amplitude):
    whole = amplitude / amplitude.max()
    for levels in (255 * whole, 255 * whole**2, 255 - volume.intensities):
        wrong = replace(volume, intensities=levels.astype(np.float32))
        assert "amplitudes or powers" in worst(check_volume(wrong))[1]


@pytest.mark.parametrize(("share", "judged"), [(0.003, True), (0.03, True), (0.3, False)])
def test_compression_is_judged_where_little_is_black(volume, amplitude, share, judged):
    linear = np.floor(amplitude / np.quantile(amplitude, share))  # below this, 0
    for levels, wrong in ((volume.intensities, False), (linear, True)):
        cut = np.where(linear == 0, 0, levels).astype(np.float32)
        findings = check_volume(replace(volume, intensities=cut))
        assert (worst(findings) is not None) == (wrong and judged)
        assert any("cannot be judged: 0 of" in each.text for each in findings) != judged


def test_a_wrong_or_missing_time_is_no_gap():
    for wrong, told in ((50.0, "runs back"), (-50.0, "runs back"), (np.nan, "in range")):
        times = TIMES.copy()
        times[12] = wrong
        texts = [each.text for each in check_times(times)]
        assert not any("gaps" in each for each in texts)
        assert any(told in each for each in texts)


@pytest.mark.parametrize(("delay", "std", "needed"), [(0.06, 0.005, True), (0.06, 0.05, False)])
def test_delay_counts_where_its_interval_leaves_zero(delay, std, needed):
    covariance = np.diag([std**2, *[1e-6] * 3, *[1e-6] * 3])
    errors = PoseErrors(delay, np.zeros(3), np.zeros(3), covariance, 15, 20, 200)
    found = worst(check_errors(errors))
    assert (found is not None) == needed
    low, high = 1e3 * (delay - 2 * std), 1e3 * (delay + 2 * std)
    assert f"95 %: {low:.0f} to {high:.0f}" in check_errors(errors)[0].text


SIZE, PITCH, LATTICE = (40, 50), 0.8e-3, 1e-3
TISSUE = gaussian_filter(np.random.default_rng(100).normal(size=(50, 60, 60)), 1.5)


def sweeps(delay, count=4, frames=40, period=0.05):
    """Frames of a probe that slides to and fro over still tissue, with poses that are late."""

    def along(time):
        phase = time / (frames * period)
        return 0.024 * (0.5 - 0.5 * np.cos(np.pi * phase))

    X_FI = np.diag([PITCH, PITCH, 1e-3, 1.0])
    i, j = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]), indexing="ij")
    made = []
    for sweep in range(count):
        made.append([])
        for k in range(frames):
            time = (sweep * frames + k) * period
            where = np.stack([PITCH * i, PITCH * j, np.full(SIZE, along(time))])
            place = (where + np.array([4e-3, 4e-3, 15e-3])[:, None, None]) / LATTICE
            grey = 120 + 400 * map_coordinates(TISSUE, place, order=1)
            X_WF = RigidTransform([0, 0, along(time - delay)])
            pixels = np.clip(grey, 1, 255).astype(np.float32)
            made[-1].append(PosedFrame(pixels, X_WF.GetAsMatrix4() @ X_FI, time))
    return made


@pytest.mark.parametrize("delay", [0.0, -0.12])
def test_delay_of_poses_is_found_within_its_interval(delay):
    found, std = sweep_delay(sweeps(delay))
    assert found == pytest.approx(delay, abs=0.015)
    assert abs(found - delay) < max(4 * std, 0.01)
    (finding,) = check_delay((found, std))
    assert (finding.grade is Grade.DOUBTFUL) == (abs(delay) > 0.015)


def test_frames_that_slide_in_their_own_plane_are_told():
    across = sweeps(0.0, count=1)
    assert check_across(across) == []
    assert check_across([[], *across]) == []
    turned = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    within = [[replace(each, X_WI=each.X_WI @ turned) for each in across[0]]]
    assert worst(check_across(within))[1].endswith("only 0 % of their way leads out of it")


def test_signed_bytes_are_told():
    assert check_numbers(np.zeros(3, np.uint8)) == check_numbers(np.zeros(3, np.int16)) == []
    assert check_numbers(np.zeros(3, np.int8))[0].grade is Grade.DOUBTFUL


def test_a_single_pass_tells_no_delay():
    found = sweep_delay(sweeps(0.0, count=1))
    assert isinstance(found, NotFound)
    assert check_delay(found)[0].grade is Grade.FINE


def test_poses_in_metres_and_inverted_calibrations_are_told():
    angles = np.linspace(0, 0.5, 20)
    poses = np.array([RigidTransform(RollPitchYaw(0, a, 0), [50 * a, 0, 0]) for a in angles])
    matrices = np.array([each.GetAsMatrix4() for each in poses])
    assert worst(check_motion("ProbeToTracker", matrices, angles)) is None
    far = RigidTransform([500, 300, -800]).GetAsMatrix4() @ matrices
    assert worst(check_motion("ProbeToTracker", far, angles)) is None
    found = check_motion("ProbeToTracker", np.linalg.inv(far), angles)
    assert "is it the wrong way round?" in str(found[-1])
    assert worst(check_motion("TrackerToProbe", np.linalg.inv(far), angles)) is None
    matrices[:, :3, 3] *= 1e-3
    assert "are positions in mm?" in str(check_motion("ProbeToTracker", matrices, angles)[-1])
    slid = np.tile(np.eye(4), (200, 1, 1))
    slid[:, 0, 3] = np.linspace(0, 0.04, 200)
    assert "moves smoothly" in str(check_motion("ProbeToTracker", slid, np.arange(200.0))[-1])
    slid[:, 1, 3] = 500.0  # as a robot's that holds it on a body, whose positions are not in m
    assert worst(check_motion("ProbeToTracker", slid, np.arange(200.0))) is None
    slid[:, :3, 3] = 0.1 * np.random.default_rng(3).normal(size=(200, 3))  # held
    assert worst(check_motion("ProbeToTracker", slid, np.arange(200.0))) is None
    assert check_pixels("the frames", [0.7, 0.2]).grade is Grade.FINE
    assert "right way round" in check_pixels("the frames", [1.43, 1.43]).advice
    assert check_pixels("the frames", [1.0, 1.0]).advice == "calibrate ImageToProbe"


def test_volumes_that_repeat_each_other_or_show_nothing_are_told():
    first, second = np.random.default_rng(0).normal(size=(2, 4, 5, 6))
    assert check_contents([first, second, first]) == []
    nothing, frozen = check_contents([first, first, np.full_like(first, np.nan), second, second])
    assert nothing.text == "1 of 5 volumes that were read show nothing, such as number 2"
    assert frozen.text.startswith("2 of 5 volumes that were read repeat the one before exactly")
    assert check_contents([np.zeros((4, 4), np.uint8)], "frames")[0].grade is Grade.DOUBTFUL
    holed = first.copy()
    holed[:, 2] = np.nan
    (lost,) = check_contents([first, holed, second])
    assert lost.text.startswith("1 of 3 volumes that were read lack whole slices")
    assert "number 1: 80 % of its voxels are there" in lost.text
    first[:2], second[:, :, 4:] = np.nan, np.nan  # their fields of view end there
    assert check_contents([first, second]) == []
    image = np.diag([1.43, 1.43, 1.43, 1.0])
    assert "right way round" in check_matrices("ImageToProbe", image)[0].advice
