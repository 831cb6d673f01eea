"""The leaf that lets the tissue react, and a scanner that sees it."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from renderers import CLEAN, NOWHERE, World

from sonoservo.systems.signals import Needle
from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import (
    NeedleDragParameters,
    Scanner,
    Tissue,
    TissueReaction,
    TissueReactionParameters,
)
from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    Drag,
    advance_drag,
)

PRESSED = RigidTransform(RotationMatrix(RollPitchYaw(-np.pi / 2, 0, 0)), [0, 0, -4e-3])
DRAG = NeedleDragParameters(distance=1e-3, slip_time=0.1)
IMAGING = ImagingParameters(sector=0.4, depth=0.05, frames=3, volume_rate=8)


def pushed(time):
    """A needle that enters at 0.5 s, at 8 mm/s, and stops at 2 s."""
    depth = 8e-3 * (min(time, 2.0) - 0.5)
    if depth <= 0:
        return NOWHERE
    return Needle(np.array([[-0.008, 0, -0.03], [depth - 0.008, 0, -0.03]]), 0.6e-3)


def simulated(parameters, scanner=None):
    """Simulator of a reacting tissue, and a function that reads a port of it or of the scanner."""
    builder = DiagramBuilder()
    still = RigidTransform()
    poses = {"true_X_WP": lambda t: PRESSED, "X_WT": lambda t: still}
    world = builder.AddSystem(World(**poses, pushed_needle=pushed))
    reaction = builder.AddSystem(TissueReaction(parameters=parameters, dome_radius=33e-3))
    for name in ("true_X_WP", "X_WT", "pushed_needle"):
        builder.Connect(world.GetOutputPort(name), reaction.GetInputPort(name))
    if scanner is not None:
        builder.AddSystem(scanner)
        for source, name in (
            (world, "true_X_WP"), (world, "X_WT"), (reaction, "needle"), (reaction, "deformation"),
        ):  # fmt: skip
            builder.Connect(source.GetOutputPort(name), scanner.GetInputPort(name))
        builder.Connect(world.GetOutputPort("true_X_WP"), scanner.GetInputPort("X_WP"))
    simulator = Simulator(builder.Build())

    def read(port):
        system = scanner if port == "sweep" else reaction
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(simulator.get_context()))

    return simulator, read


def test_drag_follows_the_needles_motion_between_samples_too():
    simulator, read = simulated(TissueReactionParameters(drag=DRAG))
    drag, now = Drag(), 0.5
    for time in (0.51, 0.6, 0.777, 1.3, 2.0, 2.5, 4.0):
        simulator.AdvanceTo(time)
        drag = advance_drag(drag, 8e-3 * (min(time, 2.0) - min(now, 2.0)), time - now, DRAG)
        now = time
        # The needle entered within a sample.
        assert read("deformation").drag == pytest.approx(drag.distance, abs=0.15e-3)
    assert read("deformation").drag == pytest.approx(0, abs=0.5e-3)
    # The drag moves the tissue and not the needle.
    np.testing.assert_array_equal(read("needle").shaft, pushed(4.0).shaft)


def test_a_needle_pushes_aside_the_stated_share_of_its_volume():
    simulator, read = simulated(TissueReactionParameters(pushed_aside=0.25))
    simulator.AdvanceTo(0.2)
    assert not read("needle")
    simulator.AdvanceTo(1.5)
    assert read("deformation").hole_radius == pytest.approx(0.3e-3)


def test_scanner_shows_the_tissue_and_the_needle_where_they_truly_are():
    scanner = Scanner(
        transducer=Transducer(), imaging=IMAGING, tissue=Tissue(seed=1), parameters=CLEAN, seed=7
    )
    parameters = TissueReactionParameters(indentation=True)
    simulator, read = simulated(parameters, scanner=scanner)
    simulator.AdvanceTo(2.01)
    sweep, needle = read("sweep"), read("needle")
    # The needle lies in the middle frame's plane; its front wall echoes.
    line = scanner.geometry.lines // 2 - 3
    sample = int(sweep.samples[1, line].argmax())
    echo = PRESSED.multiply(scanner.geometry.position(1, line, sample, 1))
    truth = np.interp(echo[0], needle.shaft[:, 0], needle.shaft[:, 2])
    assert truth < -0.0308
    assert echo[2] - needle.radius == pytest.approx(truth, abs=0.3e-3)


STICKY = NeedleDragParameters(distance=1e-3, kept=0.6, slip_time=0.1, relaxation_time=1e6)


def driven(speed, times, parameters):
    """Drag at rising times from 0 of a needle at constant speed."""
    drag, now, found = Drag(), 0.0, []
    for time in times:
        drag = advance_drag(drag, speed * (time - now), time - now, parameters)
        now = time
        found.append(drag.distance)
    return np.array(found)


def test_tissue_sticks_slides_back_and_sticks_again():
    speed, times = 5e-3, np.arange(0.001, 2, 0.001)
    found = driven(speed, times, STICKY)
    # 0.2 s to the limit; then 0.1 s down to 60 % of it and 0.08 s up again.
    phase = np.mod(times - 0.2, 0.18)
    sawtooth = np.where(phase < 0.1, 1e-3 - 4e-3 * phase, 0.6e-3 + speed * (phase - 0.1))
    np.testing.assert_allclose(found, np.where(times < 0.2, speed * times, sawtooth), atol=1e-9)


def test_result_does_not_depend_on_the_steps():
    parameters = NeedleDragParameters(distance=1e-3)
    coarse = np.array([0.7, 1.9, 3.3])
    fine = driven(8e-3, np.arange(1, 331) / 100, parameters)
    np.testing.assert_allclose(driven(8e-3, coarse, parameters), fine[[69, 189, 329]], atol=1e-12)


def test_slow_needle_never_slips_and_a_withdrawn_one_drags_backwards():
    parameters = NeedleDragParameters(distance=1e-3, relaxation_time=2.0)
    assert driven(0.4e-3, [60.0], parameters)[0] == pytest.approx(0.8e-3)
    there = driven(5e-3, np.arange(1, 50) / 30, parameters)
    back = driven(-5e-3, np.arange(1, 50) / 30, parameters)
    np.testing.assert_allclose(back, -there)
    assert there.max() <= 1e-3
    assert there.max() > 0.95e-3
