"""Faults in the loop of station, controller and guard on the default contact, without images."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from sonoservo.diagrams import (
    MakeProbeController,
    MakeStation,
    ProbeControllerParameters,
    ProbePlacement,
    StationParameters,
)
from sonoservo.systems.robot import Breathing, Move, PhantomMotionParameters
from sonoservo.systems.robot.errors.sensor_faults import SensorFault, faulty_sample
from sonoservo.systems.robot.phantom_motion import phantom_trajectory
from sonoservo.systems.signals import GuardState, NeedleCurve, NeedleEstimate, TrackingMode

STEP, DEFAULT = 0.01, ProbeControllerParameters()
PHASES = {"approach": 0.3, "landing": 0.85, "pressing": 1.6, "following": 1.6}
"""Start of the fault in each phase, in s; in the last one, the probe also follows a needle."""

PEAK, LONGEST = 15.0, 0.05
"""Force in N above which the contact may be no longer than this time in s."""

HEALED = 5.0
"""Longest fault in s after which work must go on without a person."""

_PATIENCE = 25.0
"""Time in s after which it must: the wait after the second doubt, and ways through 80 mm of air."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault on the wires.

    `where` is "wrist", "arm", "pose", "gain" or "force". `kind` is one of a `SensorFault`, or
    "drift", "noise", "stuck" (a constant with the sensor's noise) or "flicker" (NaN in every other
    sample); for a pose it is "nan", "frozen" or "jump", and for gain and force always "nan".
    """

    where: str = "wrist"
    kind: str = "nan"
    value: float = 0.0
    start: float = PHASES["pressing"]
    duration: float = 1.0

    @property
    def end(self) -> float:
        return self.start + self.duration

    def holds(self, time: float) -> bool:
        return -1e-9 <= time - self.start < self.duration - 1e-9


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """Faults, the body's motion, and the latency in s of the wrist's samples.

    `alone`: the arm's torques are not connected.
    """

    name: str = ""
    phase: str = "pressing"
    faults: tuple[Fault, ...] = ()
    motion: PhantomMotionParameters = field(default_factory=PhantomMotionParameters)
    latency: float = 0.0
    controller: ProbeControllerParameters = field(default_factory=ProbeControllerParameters)
    alone: bool = False
    duration: float = 0.0

    @property
    def end(self) -> float:
        moved = [move.start + move.duration for move in self.motion.moves]
        ends = [fault.end for fault in self.faults if fault.duration < 30]
        return max([*moved, *ends, PHASES[self.phase] + 1.0, self.duration])

    @property
    def heals(self) -> bool:
        """Whether everything is well again after it, so that work must go on."""
        # A face 4 mm deep presses with 2 N.
        sunk = 0.004 - sum(move.translation[2] for move in self.motion.moves)
        return (
            all(fault.duration <= HEALED for fault in self.faults)
            and self.latency <= (0.05 if self.controller.force == DEFAULT.force else 0.01)
            and sunk <= min(0.015, self.controller.guards.max_depth)
        )


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """What happened: forces in N, times in s."""

    case: FaultCase
    peak: float
    longest_above: float
    reasons: tuple[str, ...]
    state: GuardState
    recovered: bool

    @property
    def faults(self) -> list[str]:
        """What did not hold."""
        case = self.case
        wrong = []
        if self.longest_above > LONGEST + 1e-9:
            wrong.append("force")
        if self.state is not GuardState.MONITORING and not all(self.reasons):
            wrong.append("reason")
        if case.heals and not self.recovered:
            wrong.append("work")
        return wrong


class _Scripted(LeafSystem):
    """Phantom, needle, instruments and settings as a case wants them; nothing of it is a block."""

    def __init__(self, X_WT, joints, controller):
        super().__init__()
        self.X_WT, self.case, self.controller = X_WT, FaultCase(), controller
        self.DeclareAbstractInputPort("true_force", Value(SpatialForce()))
        self.DeclareAbstractInputPort("true_pose", Value(RigidTransform()))
        self.DeclareVectorInputPort("true_torque", joints)
        self.DeclareVectorOutputPort("external_torque", joints, self._calc_torque)
        self.joints = joints
        self.DeclareVectorOutputPort("phantom_command", 12, self._calc_phantom)
        self.DeclareVectorOutputPort("gain", 1, self._calc_gain)
        self.DeclareVectorOutputPort("force_target", 1, self._calc_target)
        for name, value, calc in (
            ("wrist_force", Value(SpatialForce.Zero()), self._calc_force),
            ("X_WP", Value(RigidTransform()), self._calc_pose),
            ("estimate", Value[object](), self._calc_estimate),
        ):
            self.DeclareAbstractOutputPort(name, value.Clone, calc)
        self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0, self._remember)
        self.DeclareDiscreteState(1)

    def set(self, case):
        self.case = case
        self.path = phantom_trajectory(case.motion, self.X_WT)
        self.held, self.samples = {}, {}

    def _fault(self, where, time):
        return next((f for f in self.case.faults if f.where == where and f.holds(time)), None)

    def _remember(self, context, state):
        time = context.get_time()
        self.samples[round(time / STEP)] = (
            self.GetInputPort("true_force").Eval(context).get_coeffs()
        )
        for where, port in (("wrist", "true_force"), ("pose", "true_pose"), ("arm", "true_torque")):
            if self._fault(where, time) is None:
                value = self.GetInputPort(port).Eval(context)
                self.held[where] = value.get_coeffs() if where == "wrist" else value

    def _calc_phantom(self, context, output):
        time = context.get_time()
        value, rate = self.path.value(time), self.path.EvalDerivative(time)
        output.SetFromVector(np.concatenate([value, rate]).ravel())

    def _calc_force(self, context, output):
        time = context.get_time()
        sample = self.GetInputPort("true_force").Eval(context).get_coeffs()
        number, lag = round(time / STEP), round(self.case.latency / STEP)
        if lag and self.samples:
            noise = 0.02 * np.random.default_rng(number).standard_normal(6)
            early = self.samples[min(self.samples)] + noise
            sample = self.samples.get(number - lag, early)
        fault = self._fault("wrist", time)
        if fault is not None:
            sample = self._wrong(fault, sample, self.held.get("wrist", sample), time)
        output.set_value(SpatialForce(sample))

    def _wrong(self, fault, sample, held, time):
        number = round(time / STEP)
        along = np.array([0.0, 0.0, 0.0, 0.0, fault.value, 0.0])
        noise = 0.02 * np.random.default_rng(number).standard_normal(6)
        if fault.kind == "drift":
            return sample + (time - fault.start) * along
        if fault.kind == "noise":
            return sample + fault.value / 0.02 * noise
        if fault.kind == "stuck":
            return held + along + noise
        if fault.kind == "flicker":
            return np.full(6, np.nan) if number % 2 else sample
        kind = SensorFault(kind=fault.kind, value=fault.value)
        return faulty_sample(kind, sample, held, number, noise=0.02)

    def _calc_torque(self, context, output):
        torque, fault = (
            self.GetInputPort("true_torque").Eval(context),
            self._fault("arm", context.get_time()),
        )
        if fault is not None:
            rng = np.random.default_rng(round(context.get_time() / STEP))
            noise = 0.1 * rng.standard_normal(self.joints)
            torque = {
                "nan": np.full(self.joints, np.nan),
                "frozen": self.held.get("arm", torque),
                "dead": noise,
                "bias": torque + fault.value,
                "stuck": self.held.get("arm", torque) + noise,
            }[fault.kind]
        output.SetFromVector(torque)

    def _calc_gain(self, context, output):
        broken = self._fault("gain", context.get_time())
        output.SetFromVector([np.nan if broken else self.controller.settings.gain])

    def _calc_target(self, context, output):
        broken = self._fault("force", context.get_time())
        output.SetFromVector([np.nan if broken else self.controller.settings.force])

    def _calc_pose(self, context, output):
        pose, fault = (
            self.GetInputPort("true_pose").Eval(context),
            self._fault("pose", context.get_time()),
        )
        if fault is not None:
            shift = {"nan": np.nan, "jump": 0.03, "frozen": 0.0}[fault.kind]
            pose = self.held.get("pose", pose) if fault.kind == "frozen" else pose
            pose = RigidTransform(pose.rotation(), pose.translation() + np.array([shift, 0.0, 0.0]))
        output.set_value(pose)

    def _calc_estimate(self, context, output):
        time = context.get_time()
        if self.case.phase != "following" or time < 1.2:
            output.set_value(NeedleEstimate(TrackingMode.SEARCHING, time))
            return
        tip = np.array([0.5 + 0.01 * min(time - 1.2, 5.0), 0.0, 0.155])
        curve = NeedleCurve(np.array([tip - [0.05, 0, 0], tip]))
        velocity = np.array([[0, 0, 0], [0.01, 0, 0]])
        covariance = 1e-8 * np.eye(12)
        output.set_value(NeedleEstimate(TrackingMode.TRACKING, time, curve, velocity, covariance))


class FaultLoop:
    """One diagram for any number of cases with the same controller."""

    def __init__(self, controller: ProbeControllerParameters, alone: bool = False):
        plant = MultibodyPlantConfig(time_step=STEP)
        parameters = StationParameters(plant=plant, probe=ProbePlacement(height=0.008))
        builder = DiagramBuilder()
        station = builder.AddSystem(MakeStation(parameters=parameters))
        self.controller = builder.AddSystem(
            MakeProbeController(parameters=controller, surface=parameters.phantom_position)
        )
        torque = station.GetOutputPort("external_torque")
        self.script = builder.AddSystem(_Scripted(parameters.X_WT, torque.size(), controller))
        self.target = controller.force.force
        wires = [
            (station, "wrist_force", self.script, "true_force"),
            (station, "X_WP", self.script, "true_pose"),
            (station, "external_torque", self.script, "true_torque"),
            (station, "joint_state", self.controller, "joint_state"),
            (self.script, "phantom_command", station, "phantom_command"),
            (self.controller, "joint_command", station, "joint_command"),
        ]
        for name in ("wrist_force", "X_WP", "estimate", "gain", "force_target"):
            wires.append((self.script, name, self.controller, name))
        if not alone and controller.guards.enabled:
            wires.append((self.script, "external_torque", self.controller, "external_torque"))
        for source, output, sink, port in wires:
            builder.Connect(source.GetOutputPort(output), sink.GetInputPort(port))
        self.force = LogVectorOutput(station.GetOutputPort("contact_force"), builder, STEP)
        self.diagram = builder.Build()

    def run(self, case: FaultCase) -> FaultResult:
        self.script.set(case)
        context = self.diagram.CreateDefaultContext()
        simulator = Simulator(self.diagram, context)
        mine = self.controller.GetMyContextFromRoot(context)
        reasons, working = [], 0.0
        last = case.end + (_PATIENCE if case.heals else 2.0)
        for time in np.arange(0.05, last, 0.05):
            simulator.AdvanceTo(time)
            state = GuardState.MONITORING
            if self.controller.HasOutputPort("guard"):
                status = self.controller.GetOutputPort("guard").Eval(mine)
                state = status.state
                if status.stopped and status.reason not in reasons:
                    reasons.append(status.reason)
            # A force law at its ceilings swings, so the mean of a second counts.
            force = self.force.FindLog(context).data()[0][-100:].mean()
            works = state is GuardState.MONITORING and 0.5 < force / self.target < 1.5
            working = working + 0.05 if works else 0.0
            if time > case.end and working > 0.5 and case.heals:
                break
        log = self.force.FindLog(context)
        force = log.data()[0]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], force > PEAK, [0]])))
        spans = edges[1::2] - edges[::2]
        return FaultResult(
            case=case,
            peak=float(force.max()),
            longest_above=STEP * float(spans.max(initial=0)),
            reasons=tuple(reasons),
            state=state,
            recovered=bool(working > 0.3),
        )


def rise(height: float, speed: float, start: float = PHASES["pressing"]) -> Move:
    """A move up at a highest speed in m/s, which a cubic reaches half-way."""
    return Move(
        start=start, duration=1.5 * abs(height) / speed, translation=[0.0, 0.0, float(height)]
    )


CEILINGS = {
    "visual_servo": {"gain": 10.0, "max_speed": 0.1, "max_angular_speed_deg": 90.0},
    "force": {
        "force": 8.0, "proportional_gain": 0.1, "integral_gain": 1.0,
        "filter_time": 0.1, "approach_speed": 0.05, "retreat_speed": 0.1,
    },
    "kinematics": {"axis_gain": 10.0},
}  # fmt: skip

GUARDS = {
    "max_force": (10.0, 11.0), "disagreement": (1.5, 4.0), "max_depth": (0.012, 0.03),
    "max_rise": (0.04, 0.1), "retreat_speed": (0.2, 0.5), "retreat_acceleration": (10.0, 20.0),
    "clearance": (0.011, 0.04), "max_retreat": (0.15, 0.3), "resume_after": (0.1, 1.0),
}  # fmt: skip
"""Floors and ceilings of the guard's own parameters that can be combined with the defaults."""


def changed(values) -> ProbeControllerParameters:
    """Controller with other parameters: {block: {parameter: value}}."""
    start = ProbeControllerParameters()
    blocks = {name: replace(getattr(start, name), **each) for name, each in values.items()}
    return replace(start, **blocks)


KINDS = (
    ("wrist", "nan", 0), ("wrist", "frozen", 0), ("wrist", "dead", 0), ("wrist", "flicker", 0),
    ("wrist", "saturated", 70), ("wrist", "saturated", -70), ("wrist", "saturated", -5.6),
    ("wrist", "jumping", 20), ("wrist", "bias", -10), ("wrist", "bias", -3), ("wrist", "bias", 5),
    ("wrist", "bias", 12), ("wrist", "bias", 0.8), ("wrist", "bias", -1.4), ("wrist", "drift", -5),
    ("wrist", "drift", 0.5), ("wrist", "noise", 2), ("wrist", "stuck", 0), ("wrist", "stuck", 1.5),
    ("wrist", "stuck", -1.5), ("arm", "nan", 0), ("arm", "frozen", 0), ("arm", "dead", 0),
    ("arm", "bias", 1.0), ("arm", "bias", -2.0), ("arm", "stuck", 0), ("pose", "nan", 0),
    ("pose", "frozen", 0), ("pose", "jump", 0), ("gain", "nan", 0), ("force", "nan", 0),
)  # fmt: skip
"""Kinds of faults: where, what, and a value in N, N/s or N m."""

DURATIONS = (0.02, 0.1, 0.4, 1.5, 4.5, 60.0)


def draw_case(seed: int) -> FaultCase:
    """Case drawn by a seed: one or two faults, with whatever body, latency and parameters."""
    rng = np.random.default_rng([seed, 43])
    phase = str(rng.choice(list(PHASES)))
    start = PHASES[phase]
    faults = []
    first = seed % len(KINDS)  # every kind comes as often
    for number in range(int(rng.integers(1, 3))):
        where, kind, value = KINDS[first if number == 0 else int(rng.integers(len(KINDS)))]
        begins = start + float(rng.uniform(0, 0.3)) * (number + 1)
        duration = float(rng.choice(DURATIONS))
        fault = Fault(where=where, kind=kind, value=value, start=begins, duration=duration)
        if all(each.where != where for each in faults):
            faults.append(fault)
    moves, breathing = [], Breathing()
    what = rng.random()
    if what < 0.45:
        height = float(rng.choice([-0.01, 0.01, 0.02, 0.03, 0.05]))
        moves.append(rise(height, float(rng.uniform(0.01, 0.1)), start + float(rng.uniform(0, 1))))
    elif what < 0.6:
        moves.append(rise(float(rng.choice([0.02, 0.05])), 0.1, start + float(rng.uniform(0, 1))))
    elif what < 0.75:
        breathing = Breathing(
            peak_to_peak=float(rng.uniform(0.003, 0.015)), rate=float(rng.uniform(0.2, 0.5)),
            direction=[0.0, 0.0, 1.0],
        )  # fmt: skip
    elif what < 0.85:
        tilt = rng.uniform(-12, 12, size=2).tolist()
        moves.append(Move(start=start, duration=0.5, rotation_deg=[*tilt, 0.0]))
    latency = float(rng.choice([0.01, 0.03, 0.05, 0.1, 0.3])) if rng.random() < 0.3 else 0.0
    values: dict[str, dict] = {"force": {}, "visual_servo": {}, "kinematics": {}, "guards": {}}
    if rng.random() < 0.4:
        for block, limits in CEILINGS.items():
            for name, value in limits.items():
                if rng.random() < 0.3:
                    values[block][name] = value
    if rng.random() < 0.3:
        for name, choices in GUARDS.items():
            if rng.random() < 0.3:
                values["guards"][name] = float(rng.choice(choices))
    if rng.random() < 0.2:
        lean = np.radians(rng.uniform(-15, 15))
        values["kinematics"]["axis"] = [float(np.sin(lean)), 0.0, -float(np.cos(lean))]
    controller = changed({name: each for name, each in values.items() if each})
    motion = PhantomMotionParameters(moves=moves, breathing=breathing)
    return FaultCase(
        name=str(seed), phase=phase, faults=tuple(faults), motion=motion, latency=latency,
        controller=controller,
    )  # fmt: skip


def run_faults(cases: Iterable[FaultCase]) -> list[FaultResult]:
    """Run cases, with one diagram for each controller in a row."""
    loop, made_for = None, None
    results = []
    for case in cases:
        if loop is None or (case.controller, case.alone) != made_for:
            loop, made_for = FaultLoop(case.controller, case.alone), (case.controller, case.alone)
        results.append(loop.run(case))
    return results
