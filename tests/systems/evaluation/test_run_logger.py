import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from sonoservo.systems.evaluation import RunLogger
from sonoservo.systems.evaluation.run_logger import visible_length
from sonoservo.systems.signals import (
    GuardState,
    GuardStatus,
    MotionRecord,
    Needle,
    NeedleCurve,
    NeedleEstimate,
    NeedleMeasurement,
    NotFound,
    SweepGeometry,
    SweepMotion,
    TrackingMode,
    VolumeCheck,
)

X_WP = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.4, 0.5, 0.6])
X_WT = RigidTransform(RollPitchYaw(0.0, 0.0, 0.5), [0.1, 0.2, 0.3])
NEEDLE = Needle([[0, 0, 0], [0.03, 0, 0], [0.03, 0.04, 0]], 6e-4)
CURVE = NeedleCurve([[0.0, 0, 0], [0.02, 0, 0.01]])


def estimate(volume_time, mode=TrackingMode.TRACKING):
    if mode == TrackingMode.SEARCHING:
        return NeedleEstimate(mode, volume_time, volume_time=volume_time)
    velocity = [[0, 0, 0], [0.001, 0.002, 0.003]]
    return NeedleEstimate(mode, volume_time, CURVE, velocity, np.eye(12), volume_time)


def connected(logger):
    """A context in which every port has a value."""
    context = logger.CreateDefaultContext()
    connect(logger, context)
    return context


def connect(logger, context):
    for name, value in {
        "X_WP": Value(X_WP),
        "X_WT": Value(X_WT),
        "needle": Value[object](NEEDLE),
        "estimate": Value[object](estimate(0.5)),
        "measurement": Value[object](NeedleMeasurement(CURVE, np.eye(6), 0.6, 300, 0.4)),
        "detection": Value[object](NotFound("nothing moved")),
        "wrist_force": Value(SpatialForce([1, 2, 3], [4, 5, 6])),
        "guard": Value[object](GuardStatus(GuardState.HOLDING, "the sensor is frozen", 0.2, 1)),
        "hold_reason": Value[object]("the tip is uncertain by 35 mm"),
        "volume_check": Value[object](VolumeCheck(5, 2, "a volume is refused: it is blank")),
    }.items():
        logger.GetInputPort(name).FixValue(context, value)
    logger.GetInputPort("joint_state").FixValue(context, np.arange(12.0))
    logger.GetInputPort("contact_force").FixValue(context, [2.5])
    logger.GetInputPort("planar_velocity").FixValue(context, [0.1, 0.2, 0.3])


def test_a_sample_and_a_volume():
    logger = RunLogger()
    context = connected(logger)
    context.SetTime(0.7)
    logger.ForcedPublish(context)
    log = logger.log(context, compute={"render": [0.04]})
    wanted = {
        "time": 0.7, "X_WP": X_WP.GetAsMatrix4(), "X_WT": X_WT.GetAsMatrix4(),
        "needle_tip": X_WT.multiply([0.03, 0.04, 0]), "needle_entry": X_WT.translation(),
        "inserted_length": 0.07, "estimate_tip": CURVE.tip, "estimate_direction": CURVE.direction,
        "estimate_velocity": [0.001, 0.002, 0.003], "joint_state": np.arange(12),
        "contact_force": 2.5, "wrist_force": [1, 2, 3, 4, 5, 6], "planar_velocity": [0.1, 0.2, 0.3],
        "volumes_refused": 2, "volume_time": 0.5, "volume_seen": 0.7, "volume_detected": False,
        "volume_measured_time": 0.6, "volume_inlier_count": 300, "volume_measured_tip": CURVE.tip,
        "volume_estimate_entry": CURVE.entry,
    }  # fmt: skip
    for name, value in wanted.items():
        np.testing.assert_allclose(getattr(log, name), [value], atol=1e-15, err_msg=name)
    words = {
        "estimate_mode": "tracking", "guard_state": "holding",
        "guard_reason": "the sensor is frozen", "hold_reason": "the tip is uncertain by 35 mm",
        "refusal_reason": "a volume is refused: it is blank",
        "volume_detection_reason": "nothing moved", "volume_measurement_reason": "",
    }  # fmt: skip
    assert {name: getattr(log, name).tolist() for name in words} == {
        name: [value] for name, value in words.items()
    }
    assert log.compute["render"] == [0.04]


def test_what_is_not_there_is_missing():
    logger = RunLogger()
    context = logger.CreateDefaultContext()
    logger.ForcedPublish(context)  # nothing is connected
    connect(logger, context)
    context.SetTime(1.0)
    logger.GetInputPort("needle").FixValue(context, Value[object](Needle(np.zeros((0, 3)), 1e-3)))
    searching = estimate(0.9, TrackingMode.SEARCHING)
    logger.GetInputPort("estimate").FixValue(context, Value[object](searching))
    nothing = Value[object](NotFound("no line"))
    logger.GetInputPort("measurement").FixValue(context, nothing)
    logger.ForcedPublish(context)
    log = logger.log(context)
    assert np.isnan(log.X_WP[0]).all()
    assert log.estimate_mode.tolist() == ["", "searching"]
    assert np.isnan(log.inserted_length[0])
    assert log.inserted_length[1] == 0
    assert np.isnan(log.needle_tip).all()
    assert np.isnan(log.estimate_tip).all()
    assert log.volume_measurement_reason == ["no line"]
    assert np.isnan(log.volume_measured_tip).all()


def test_measured_and_true_motion_are_both_kept():
    logger = RunLogger()
    context = connected(logger)
    true = RigidTransform([7.0, 8.0, 9.0])
    logger.GetInputPort("true_X_WP").FixValue(context, Value(true))
    geometry = SweepGeometry(0.04, 0.027, 0.01, 0.02, 0.3e-3, 9, 3, 30, 0.1)
    record = MotionRecord(
        measured=SweepMotion.at_rest(geometry, X_WP, [0.4, 0.5, 0.6]),
        true=SweepMotion.at_rest(geometry, true, [0.38, 0.48, 0.58]),
    )
    logger.GetInputPort("motion_record").FixValue(context, Value[object](record))
    logger.ForcedPublish(context)
    context.SetTime(1.0)
    logger.GetInputPort("estimate").FixValue(context, Value[object](estimate(0.9)))
    logger.ForcedPublish(context)  # of another volume: its motion is not known
    log = logger.log(context)
    np.testing.assert_array_equal(log.X_WP[0], true.GetAsMatrix4())
    np.testing.assert_array_equal(log.measured_X_WP[0], X_WP.GetAsMatrix4())
    np.testing.assert_array_equal(log.volume_X_WP[0], X_WP.GetAsMatrix4())
    np.testing.assert_array_equal(log.volume_true_X_WP[0], true.GetAsMatrix4())
    np.testing.assert_array_equal(log.volume_true_time, [0.48, np.nan])


class Tracker(LeafSystem):
    """Has seen the volume of the time of its every event, 0.1 s before."""

    PERIOD = 0.25

    def __init__(self):
        super().__init__()
        index = self.DeclareAbstractState(
            Value[object](NeedleEstimate(TrackingMode.SEARCHING, 0.0))
        )
        self.DeclareStateOutputPort("estimate", index)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.PERIOD, 0.2, self._update)

    def _update(self, context, state):
        state.get_mutable_abstract_state(0).set_value(estimate(context.get_time() - 0.1))


def simulate(logger, **stop):
    builder = DiagramBuilder()
    tracker = builder.AddSystem(Tracker())
    builder.AddSystem(logger)
    builder.Connect(tracker.GetOutputPort("estimate"), logger.GetInputPort("estimate"))
    return Simulator(builder.Build())


def log_of(logger, simulator):
    return logger.log(logger.GetMyContextFromRoot(simulator.get_context()))


def test_in_a_diagram_every_sample_and_volume_is_kept_once():
    logger = RunLogger(period=1 / 128, volume_period=0.25, volume_offset=0.2 + 1e-6)
    simulator = simulate(logger)
    simulator.AdvanceTo(2.0)
    log = log_of(logger, simulator)
    np.testing.assert_array_equal(log.time, np.arange(257) / 128)
    np.testing.assert_allclose(log.volume_time, 0.1 + 0.25 * np.arange(8))
    np.testing.assert_allclose(log.volume_seen, 0.2 + 0.25 * np.arange(8) + 1e-6)
    assert log.estimate_mode[25] == "searching"  # 0.195 s, before the first volume
    assert log.estimate_mode[26] == "tracking"
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()  # each run begins anew
    assert len(log_of(logger, simulator).time) == 1
    assert len(log_of(logger, simulator).volume_time) <= 1


def test_length_in_view_ends_where_the_sector_ends():
    geometry = SweepGeometry(0.04, 0.02725, 0.0106, 0.0255, 0.308e-3, 96, 27, 293, 0.0113)
    half_width = (0.04 + 0.05) * np.tan(0.0106 * 47.5)  # q tan(phi) at the outermost line
    inside, outside = np.array([0.0, 0.05, 0.0]), np.array([-0.2, 0.05, 0.0])
    assert visible_length(Needle([outside, inside], 6e-4), geometry) == pytest.approx(
        half_width, abs=1e-3
    )
    assert visible_length(Needle([outside, outside / 1.1], 6e-4), geometry) == 0
    assert visible_length(Needle(np.zeros((0, 3)), 6e-4), geometry) == 0
    bent = Needle([[0.0, 0.05, 0.0], [0.01, 0.05, 0.0], [0.01, 0.06, 0.0]], 6e-4)
    assert visible_length(bent, geometry) == pytest.approx(0.02, abs=1e-3)
