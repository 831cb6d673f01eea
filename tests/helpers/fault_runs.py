"""Faults in the loop of station and controller, with point contact and without images."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from sonoservo.diagrams.probe_controller import MakeProbeController, ProbeControllerParameters
from sonoservo.diagrams.station import MakeStation, ProbePlacement, StationParameters
from sonoservo.systems.robot.errors.sensor_faults import SensorFault, faulty_sample
from sonoservo.systems.robot.phantom_motion import (
    Move,
    PhantomMotionParameters,
    phantom_trajectory,
)
from sonoservo.systems.signals.guard_status import GuardState
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

STEP = 0.01
PHASES = {"approach": 0.3, "landing": 0.85, "pressing": 1.6, "following": 1.6}
"""Start of the fault in each phase, in s; in the last one, the probe also follows a needle."""


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """One fault. `pose` is "", "nan", "frozen" or "jump", and holds as long as `sensor` would."""

    name: str
    phase: str = "pressing"
    sensor: SensorFault | None = None
    pose: str = ""
    move: Move | None = None
    duration: float = 1.0
    after: float = 1.5
    controller: ProbeControllerParameters = field(default_factory=ProbeControllerParameters)

    @property
    def start(self) -> float:
        return PHASES[self.phase]

    @property
    def end(self) -> float:
        return self.start + max(self.duration, self.move.duration if self.move else 0.0)


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """What happened: forces in N, times in s."""

    case: FaultCase
    peak: float
    longest_above: float
    above_after_stop: float
    reasons: tuple[str, ...]
    recovered: bool
    force_at_end: float


class _Scripted(LeafSystem):
    """Phantom, needle, wrist sensor and pose as a case wants them; nothing of it is a block."""

    def __init__(self, X_WT):
        super().__init__()
        self.X_WT, self.case = X_WT, None
        self.DeclareAbstractInputPort("true_force", Value(SpatialForce()))
        self.DeclareAbstractInputPort("true_pose", Value(RigidTransform()))
        self.DeclareDiscreteState(6)
        self.held_pose = RigidTransform()
        self.DeclareVectorOutputPort("phantom_command", 12, self._calc_phantom)
        for name, value, calc in (
            ("wrist_force", Value(SpatialForce.Zero()), self._calc_force),
            ("X_WP", Value(RigidTransform()), self._calc_pose),
            ("estimate", Value[object](None), self._calc_estimate),
        ):
            self.DeclareAbstractOutputPort(name, value.Clone, calc)
        self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0, self._remember)

    def set(self, case):
        moves = [replace(case.move, start=case.start)] if case.move else []
        self.case = case
        self.path = phantom_trajectory(PhantomMotionParameters(moves=moves), self.X_WT)

    def _holds(self, context):
        return 0 <= context.get_time() - self.case.start < self.case.duration

    def _remember(self, context, state):
        if not self._holds(context):
            state.set_value(self.GetInputPort("true_force").Eval(context).get_coeffs())
            self.held_pose = RigidTransform(self.GetInputPort("true_pose").Eval(context))

    def _calc_phantom(self, context, output):
        time = context.get_time()
        value, rate = self.path.value(time), self.path.EvalDerivative(time)
        output.SetFromVector(np.concatenate([value, rate]).ravel())

    def _calc_force(self, context, output):
        force = self.GetInputPort("true_force").Eval(context)
        if self.case.sensor is not None and self._holds(context):
            held, number = context.get_discrete_state_vector().value(), context.get_time() / STEP
            sample = faulty_sample(
                self.case.sensor, force.get_coeffs(), held, round(number), noise=0.02
            )
            force = SpatialForce(sample)
        output.set_value(force)

    def _calc_pose(self, context, output):
        pose = self.GetInputPort("true_pose").Eval(context)
        if self.case.pose and self._holds(context):
            shift = {"nan": np.nan, "jump": 0.03, "frozen": 0.0}[self.case.pose]
            pose = self.held_pose if self.case.pose == "frozen" else pose
            pose = RigidTransform(pose.rotation(), pose.translation() + np.array([shift, 0.0, 0.0]))
        output.set_value(pose)

    def _calc_estimate(self, context, output):
        time = context.get_time()
        if self.case.phase != "following" or time < 1.2:
            output.set_value(NeedleEstimate(TrackingMode.SEARCHING, time))
            return
        tip = np.array([0.5 + 0.01 * (time - 1.2), 0.0, 0.155])
        curve = NeedleCurve(np.array([tip - [0.05, 0, 0], tip]))
        velocity = np.array([[0, 0, 0], [0.01, 0, 0]])
        covariance = 1e-8 * np.eye(12)
        output.set_value(NeedleEstimate(TrackingMode.TRACKING, time, curve, velocity, covariance))


class FaultLoop:
    """One diagram for any number of cases with the same controller."""

    def __init__(self, controller: ProbeControllerParameters, contact_model: str = "point"):
        plant = MultibodyPlantConfig(time_step=STEP, contact_model=contact_model)
        parameters = StationParameters(plant=plant, probe=ProbePlacement(height=0.008))
        builder = DiagramBuilder()
        station = builder.AddSystem(MakeStation(parameters=parameters))
        self.controller = builder.AddSystem(
            MakeProbeController(parameters=controller, surface=parameters.phantom_position)
        )
        self.script = builder.AddSystem(_Scripted(parameters.X_WT))
        for source, output, sink, port in (
            (station, "wrist_force", self.script, "true_force"),
            (station, "X_WP", self.script, "true_pose"),
            (station, "joint_state", self.controller, "joint_state"),
            (self.script, "wrist_force", self.controller, "wrist_force"),
            (self.script, "X_WP", self.controller, "X_WP"),
            (self.script, "estimate", self.controller, "estimate"),
            (self.script, "phantom_command", station, "phantom_command"),
            (self.controller, "joint_command", station, "joint_command"),
        ):
            builder.Connect(source.GetOutputPort(output), sink.GetInputPort(port))
        self.force = LogVectorOutput(station.GetOutputPort("contact_force"), builder, STEP)
        self.diagram = builder.Build()

    def run(self, case: FaultCase) -> FaultResult:
        self.script.set(case)
        context = self.diagram.CreateDefaultContext()
        simulator = Simulator(self.diagram, context)
        mine = self.controller.GetMyContextFromRoot(context)
        status = None
        reasons = []
        for time in np.arange(0.05, case.end + case.after, 0.05):
            simulator.AdvanceTo(time)
            if self.controller.HasOutputPort("guard"):
                status = self.controller.GetOutputPort("guard").Eval(mine)
                if status.stopped and status.reason not in reasons:
                    reasons.append(status.reason)
        if status is not None and status.remark:
            reasons.append(f"({status.remark})")
        log = self.force.FindLog(context)
        times, force = log.sample_times(), log.data()[0]
        above = force > 15
        edges = np.flatnonzero(np.diff(np.concatenate([[0], above, [0]])))
        spans = edges[1::2] - edges[::2]
        stop = case.start + (case.move.duration if case.move else 0.0)
        late = times[above & (times > stop)]
        return FaultResult(
            case=case,
            peak=float(force.max()),
            longest_above=STEP * float(spans.max(initial=0)),
            above_after_stop=float(late.max() - stop) if len(late) else 0.0,
            reasons=tuple(reasons),
            recovered=status is None or status.state is GuardState.MONITORING,
            force_at_end=float(force[-1]),
        )


def phantom_move(height: float, speed: float, **more) -> Move:
    """A move up at a highest speed in m/s, which a cubic reaches half-way."""
    return Move(duration=1.5 * abs(height) / speed, translation=[0.0, 0.0, height], **more)


def sensor_cases():
    kinds = (
        ("nan", 0), ("frozen", 0), ("dead", 0), ("saturated", 70), ("saturated", -70),
        ("jumping", 20), ("bias", -10), ("bias", -3), ("bias", 5), ("bias", 12), ("bias", 0.8),
    )  # fmt: skip
    for (kind, value), phase, duration in product(kinds, PHASES, (2 * STEP, 0.4, 1.5)):
        fault = SensorFault(kind=kind, value=value)
        name = f"sensor {kind}{f' {value} N' if value else ''}, {duration} s"
        yield FaultCase(name=name, phase=phase, sensor=fault, duration=duration)


def double_cases():
    kinds = ("nan", "frozen", "dead", "bias", "jumping")
    for kind, value in zip(kinds, (0, 0, 0, -10, 20), strict=True):
        yield FaultCase(
            name=f"sensor {kind} while the phantom comes 20 mm up at 10 cm/s",
            sensor=SensorFault(kind=kind, value=value),
            move=phantom_move(0.02, 0.1),
            duration=1.5,
        )


def pose_cases():
    for pose, phase, duration in product(("nan", "frozen", "jump"), PHASES, (2 * STEP, 1.0)):
        yield FaultCase(
            name=f"pose {pose}, {duration} s", phase=phase, pose=pose, duration=duration
        )


def phantom_cases():
    for height, speed, phase in product(
        (0.01, 0.02, 0.05), (0.05, 0.1, 0.25, 0.6), ("approach", "pressing", "following")
    ):
        name = f"phantom {1e3 * height:g} mm up at {1e2 * speed:g} cm/s"
        yield FaultCase(
            name=name, phase=phase, move=phantom_move(height, speed), duration=0, after=2.5
        )
    for height in (-0.01, -0.03):
        yield FaultCase(
            name=f"phantom {-1e3 * height:g} mm down", move=phantom_move(height, 0.1), duration=0
        )
    for roll in (-15.0, 15.0):
        move = Move(duration=0.5, rotation_deg=[0.0, roll, 0.0])
        yield FaultCase(name=f"phantom tilts by {roll:g} deg", move=move, duration=0)
    move = Move(duration=0.3, translation=[0.05, 0.0, 0.0])
    yield FaultCase(name="phantom 50 mm aside", move=move, duration=0)


CEILINGS = {
    "visual_servo": {"gain": 10.0, "max_speed": 0.1, "max_angular_speed_deg": 90.0},
    "force": {
        "force": 8.0, "proportional_gain": 0.1, "integral_gain": 1.0,
        "filter_time": 0.1, "approach_speed": 0.05, "retreat_speed": 0.1,
    },
    "kinematics": {"axis_gain": 10.0},
}  # fmt: skip


def at_ceilings(values) -> ProbeControllerParameters:
    """Controller with parameters at their ceilings: {block: {parameter: value}}."""
    start = ProbeControllerParameters()
    blocks = {name: replace(getattr(start, name), **each) for name, each in values.items()}
    return replace(start, **blocks)


def ceiling_cases():
    settings = {"all": CEILINGS}
    for name in ("force", "proportional_gain", "integral_gain", "filter_time", "approach_speed"):
        settings[name] = {"force": {name: CEILINGS["force"][name]}}
    for name, values in settings.items():
        controller = at_ceilings(values)
        for move in (None, phantom_move(0.02, 0.1)):
            rise = ", phantom 20 mm up at 10 cm/s" if move else ""
            yield FaultCase(
                name=f"{name} at its ceiling{rise}", controller=controller, move=move,
                phase="following" if name == "all" else "pressing",
            )  # fmt: skip


def fault_cases() -> list[FaultCase]:
    """All cases."""
    return [
        *sensor_cases(), *double_cases(), *pose_cases(), *phantom_cases(), *ceiling_cases(),
    ]  # fmt: skip


def run_faults(cases: Iterable[FaultCase], contact_model: str = "point") -> list[FaultResult]:
    """Run cases, with one diagram for each controller."""
    loop, made_for = None, None
    results = []
    for case in cases:
        if loop is None or case.controller != made_for:
            loop, made_for = FaultLoop(case.controller, contact_model), case.controller
        results.append(loop.run(case))
    return results


def fault_table(results: Iterable[FaultResult]) -> str:
    """Results as lines of text."""
    lines = ["peak N | > 15 N, s | after the stop, s | back | end N | phase, fault: reasons"]
    for each in results:
        lines.append(
            f"{each.peak:6.2f} | {each.longest_above:9.3f} | {each.above_after_stop:17.3f} | "
            f"{'yes' if each.recovered else 'no':>4} | {each.force_at_end:5.2f} | "
            f"{each.case.phase}, {each.case.name}: {'; '.join(each.reasons) or '-'}"
        )
    return "\n".join(lines)
