import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from renderers import CLEAN, NOWHERE, World

from sonoservo.systems.signals import Needle, NotFound, Sweep
from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import (
    ClockParameters,
    ConnectionParameters,
    Scanner,
    ScannerParameters,
    Tissue,
)

IMAGING = ImagingParameters(sector=0.1, depth=0.05, frames=5, volume_rate=8)
DOWN = RigidTransform(RotationMatrix(RollPitchYaw(-np.pi / 2, 0, 0)), [0, 0, -0.004])
NEEDLE = Needle(np.array([[-0.05, 0, -0.03], [0.0, 0, -0.03]]), 0.635e-3)


def make_scanner(**changes):
    arguments = {"transducer": Transducer(), "imaging": IMAGING, "tissue": Tissue()}
    return Scanner(**{**arguments, "parameters": CLEAN, "seed": 7, **changes})


def run(
    scanner, *, X_WP=lambda t: DOWN, X_WT=lambda t: RigidTransform(), needle=lambda t: NOWHERE,
    measured=None,
):  # fmt: skip
    """Simulator and a function that reads the sweep, or another port.

    Without ``measured`` poses, the true ones are all there are.
    """
    builder = DiagramBuilder()
    builder.AddSystem(scanner)
    world = World(true_X_WP=X_WP, X_WP=measured or X_WP, X_WT=X_WT, needle=needle)
    builder.AddSystem(world)
    for name in ("X_WP", "X_WT", "needle", *(["true_X_WP"] if measured else [])):
        builder.Connect(world.GetOutputPort(name), scanner.GetInputPort(name))
    simulator = Simulator(builder.Build())
    context = scanner.GetMyContextFromRoot(simulator.get_context())
    return simulator, lambda port="sweep": scanner.GetOutputPort(port).Eval(context)


def sweep_at(time, **world):
    simulator, sweep = run(make_scanner(), **world)
    simulator.AdvanceTo(time)
    return sweep()


def test_a_sweep_appears_when_its_last_frame_ends():
    scanner = make_scanner()
    simulator, sweep = run(scanner)
    period = scanner.geometry.period
    simulator.AdvanceTo(0.99 * period)
    assert not sweep()
    assert sweep() == NotFound("no sweep is complete yet")
    simulator.AdvanceTo(1.01 * period)
    assert isinstance(first := sweep(), Sweep)
    assert first.samples.shape == scanner.geometry.shape
    simulator.AdvanceTo(1.9 * period)  # more frames, the same sweep
    assert sweep() is first


def test_every_frame_has_its_own_needle():
    """The needle is there from the third frame on."""
    scanner = make_scanner()
    start = 1.5 * scanner.geometry.frame_period
    simulator, sweep = run(scanner, needle=lambda time: NEEDLE if time > start else NOWHERE)
    simulator.AdvanceTo(1.1 * scanner.geometry.period)
    brightest = sweep().samples.max(axis=(1, 2))
    assert (brightest[2:] > 180).all()
    assert (brightest[:2] < 170).all()


def test_speckle_moves_with_the_phantom():
    """Probe and phantom moved together: the same samples; the probe alone: others."""
    moved = RigidTransform(RollPitchYaw(0.2, -0.1, 0.7), [0.3, -0.2, 0.5])
    at_rest = sweep_at(0.13).samples.astype(int)
    together = sweep_at(0.13, X_WP=lambda t: moved @ DOWN, X_WT=lambda t: moved).samples
    assert np.abs(together - at_rest).max() <= 1
    alone = sweep_at(0.13, X_WP=lambda t: RigidTransform([0.002, 0, 0]) @ DOWN).samples
    assert np.corrcoef(alone.ravel(), at_rest.ravel())[0, 1] < 0.3


def test_true_pose_is_rendered_and_the_measured_one_is_the_label():
    wrong = RigidTransform([0.3, 0.2, 0.1]) @ DOWN
    labelled = sweep_at(0.13, measured=lambda t: wrong)
    plain = sweep_at(0.13)
    np.testing.assert_array_equal(labelled.samples, plain.samples)
    np.testing.assert_array_equal(labelled.motion.X_WP, np.tile(wrong.GetAsMatrix4(), (5, 1, 1)))


def moving(time):
    return RigidTransform(DOWN.rotation(), [0.01 * time, 0, -0.004])


@pytest.mark.parametrize("offset", [-0.04, 0.2])
def test_skewed_clock_gives_each_frame_the_pose_of_its_stamp(offset):
    clock = ClockParameters(offset=offset, drift=1e-3)
    scanner = make_scanner(parameters=ScannerParameters(clock=clock))
    simulator, read = run(scanner, X_WP=moving, measured=moving)
    period = scanner.geometry.period
    simulator.AdvanceTo(2.1 * period + max(offset, 0) + scanner.geometry.frame_period)
    motion, record = read().motion, read("motion_record")
    true = period + scanner.geometry.frame_times(0.0, -1)
    np.testing.assert_allclose(record.true.times, true, atol=1e-12)
    np.testing.assert_allclose(motion.times, true + offset + 1e-3 * true, atol=1e-12)
    np.testing.assert_allclose(motion.X_WP[:, 0, 3], 0.01 * motion.times, atol=1e-12)
    np.testing.assert_allclose(record.true.X_WP[:, 0, 3], 0.01 * true, atol=1e-12)
    np.testing.assert_array_equal(record.measured.times, motion.times)


def sweeps_seen(scanner, count):
    """Time at which each sweep is first seen, in periods, and its number."""
    simulator, read = run(scanner)
    period, seen = scanner.geometry.period, {}
    for time in np.arange(0.1, count * 5) * scanner.geometry.frame_period:
        simulator.AdvanceTo(time)
        record = read("motion_record")
        if record:
            number = round(record.true.time / period - 0.4)
            seen.setdefault(number, time / period - 0.02)
    return seen


def test_lost_sweeps_do_not_appear():
    connection = ConnectionParameters(lost_sweeps=0.25)
    scanner = make_scanner(parameters=ScannerParameters(connection=connection))
    seen = sweeps_seen(scanner, 61)
    assert len(seen) == pytest.approx(45, abs=4 * np.sqrt(60 * 0.25 * 0.75))
    for number, time in seen.items():
        assert time == pytest.approx(number + 1)


def test_late_sweeps_come_a_frame_or_more_later():
    connection = ConnectionParameters(lateness=0.02)
    scanner = make_scanner(parameters=ScannerParameters(connection=connection))
    seen = sweeps_seen(scanner, 61)
    late = np.array([time - (number + 1) for number, time in seen.items()])
    frame = scanner.geometry.frame_period / scanner.geometry.period
    mean = 0.02 / scanner.geometry.period + frame / 2
    assert late.mean() == pytest.approx(mean, rel=0.4)
    np.testing.assert_allclose(late / frame, np.round(late / frame), atol=1e-6)
