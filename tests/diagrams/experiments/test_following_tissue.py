"""Tissue that reacts, in the closed loop: the truth is the needle where the tissue took it."""

from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams.app.scan import scan
from sonoservo.diagrams.assembly import load_dome_radius
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scene import make_scene
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.systems.recording.side_files import read_truth
from sonoservo.systems.robot.phantom_motion import Breathing, PhantomMotionParameters
from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    NeedleDragParameters,
    TissueReactionParameters,
)

REACTION = TissueReactionParameters(
    drag=NeedleDragParameters(distance=1e-3), pushed_aside=1.0, indentation=True
)
BREATHING = Breathing(peak_to_peak=0.004, rate=0.25, direction=[0, 1, 0])


def make_scenario(**changes):
    scenario = load_scenario("chatelain2013_fig5")
    station = replace(scenario.station, probe=replace(scenario.station.probe, height=2e-3))
    hand = replace(scenario.hand, start=0.0, entry=[-0.06, 0.0, -0.042], tremor=0.0)
    imaging = replace(scenario.imaging, sector=0.2, frames=5, depth=0.06)
    return replace(scenario, duration=4.0, station=station, hand=hand, imaging=imaging, **changes)


def test_dome_of_the_default_probe_has_its_mean_curvature():
    assert load_dome_radius("4dc7_3_40") == pytest.approx(33e-3, abs=0.1e-3)


def test_truth_moves_with_the_tissue_in_log_recording_and_world(tmp_path):
    (tmp_path / "plain.yaml").write_text("tissue: {seed: 1}\n")
    scenario = make_scenario(
        tissue_reaction=REACTION,
        phantom_motion=PhantomMotionParameters(breathing=BREATHING),
        phantom=str(tmp_path / "plain.yaml"),
    )
    experiment = FollowingExperiment(scenario, record=tmp_path / "run.seq.nrrd")
    experiment.run()
    experiment.close()
    log = experiment.log()
    rest = scenario.station.X_WT.translation()
    expected = [rest + BREATHING.displacement(time) for time in log.time]
    np.testing.assert_allclose(log.X_WT[:, :3, 3], expected, atol=0.1e-3)
    hand = experiment.diagram.GetSubsystemByName("hand").GetSubsystemByName("hand")
    pushed = experiment.evaluate(hand, "needle")
    assert pushed.length > 0.02
    deformed = experiment.evaluate(experiment.diagram.GetSubsystemByName("hand"), "deformation")
    assert deformed.indentation.depth > 2e-3
    assert deformed.drag > 0.3e-3
    true = deformed.moved_needle(pushed)
    tip = log.X_WT[-1] @ [*true.tip, 1]
    np.testing.assert_allclose(log.needle_tip[-1], tip[:3], atol=1e-9)
    assert np.linalg.norm(true.tip - pushed.tip) > 0.3e-3
    truth = read_truth(tmp_path / "run.truth.jsonl")
    sample = np.abs(log.time - truth.times[-1]).argmin()
    np.testing.assert_allclose(truth.needles[-1].tip, log.needle_tip[sample], atol=0.3e-3)


def test_scan_deforms_the_tissue_as_a_run_does(tmp_path):
    (tmp_path / "plain.yaml").write_text("tissue: {seed: 1}\n")
    scenario = make_scenario(tissue_reaction=REACTION, phantom=str(tmp_path / "plain.yaml"))
    still, deformed = scan(make_scenario(), time=3.0), scan(scenario, time=3.0)
    scene, motion = make_scene(scenario), deformed.sweep.motion
    geometry = deformed.sweep.geometry
    X_TP = scenario.station.X_WT.inverse().GetAsMatrix4() @ motion.X_WP
    acquired = scene.acquire(motion, X_TP)
    np.testing.assert_array_equal(acquired.sweep.samples, deformed.sweep.samples)
    middle = acquired.deformations[geometry.frames // 2]
    assert middle.indentation.depth == pytest.approx(4e-3, abs=1e-6)
    assert 0.5e-3 < middle.drag <= 1e-3
    true = middle.moved_needle(scene.insertion.needle(3.0)).transformed(scenario.station.X_WT)
    np.testing.assert_allclose(deformed.needle.tip, true.tip, atol=1e-9)
    assert np.linalg.norm(deformed.needle.tip - still.needle.tip) > 0.3e-3


def test_scan_breathes():
    breathing = PhantomMotionParameters(breathing=BREATHING)
    still, moved = (
        scan(s, time=2.0) for s in (make_scenario(), make_scenario(phantom_motion=breathing))
    )
    np.testing.assert_allclose(moved.needle.tip - still.needle.tip, BREATHING.displacement(2.0))
