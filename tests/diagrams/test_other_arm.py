"""A scenario with an arm of seven joints, from its file to its log."""

import numpy as np

from sonoservo.diagrams.experiments.registry import load_scenario, make_experiment
from sonoservo.systems.evaluation.log import read_log, write_log


def test_a_scenario_runs_with_seven_joints_and_logs_them(tmp_path):
    scenario = load_scenario(
        "chatelain2013_fig5",
        changes=["station.arm=lbr_iiwa_14", "duration=2", "station.probe.height=0.006"],
    )
    experiment = make_experiment(scenario)
    experiment.run()
    log = experiment.log()
    assert log.joint_state.shape == (len(log.time), 14)
    assert np.isfinite(log.joint_state).all()
    # The probe has landed, and the arm has moved for it.
    assert log.contact_force[-1] > 1.0
    assert np.abs(log.joint_state[-1, :7] - log.joint_state[0, :7]).max() > 0.01
    path = write_log(tmp_path / "log.npz", log)
    again = read_log(path, type(log))
    np.testing.assert_array_equal(again.joint_state, log.joint_state)
