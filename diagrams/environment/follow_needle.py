"""The environment: an episode is a run of following in which an agent moves the probe."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from sonoservo.diagrams.dials import draw_dials_on
from sonoservo.diagrams.environment.commanded_velocity import CommandedVelocity
from sonoservo.diagrams.environment.reward import (
    ActionScale,
    MakeCommandedSettings,
    RewardParameters,
    reward_terms,
)
from sonoservo.diagrams.experiments.experiment import INSTANT
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    make_insertion,
    planned_sources,
    tracker_events,
)
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.evaluation.run_logger import visible_length
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.scan_conversion import make_grid
from sonoservo.systems.ultrasound.transducer import load_transducer

try:
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.spaces import Dict as DictSpace
    from pydrake.gym import DrakeGymEnv
except ModuleNotFoundError as error:
    raise ConfigurationError(
        "the environment needs the package gymnasium; install it with pip install 'sonoservo[gym]'"
    ) from error

ENVIRONMENT = "sonoservo/FollowNeedle-v0"
"""Name under which Gymnasium knows the environment, once this module is imported."""

OBSERVATIONS = ("features", "slices", "volume")  # kinds of observations

FEATURES = ("x", "z", "theta", "v_x", "v_z", "tip_std", "probability", "tracked", "force", "age")
"""Elements of the observation ``features``, in cm, rad, cm/s, N and s."""

_STOPPED = 5.0  # time in s for which the guard must hold the robot before an episode ends

_LARGEST = np.array([20, 20, 1.6, 30, 30, 20, 1, 1, 60, 60], np.float32)


class FollowNeedle(DrakeGymEnv):
    """A robot presses a probe on a phantom while a needle is pushed in; the agent moves the probe.

    An action is four numbers from -1 to 1: the velocity of the probe in its image's plane (v_x, v_z
    and omega_y, up to 30 mm/s and 20 deg/s) and the target of the contact force, from 1 to 4 N. All
    commands pass the force law and the guard of the robot. A step lasts one volume. The probe has
    landed, and rests, when an episode begins.

    The reward is the mean of the terms in ``info["reward_terms"]`` (`reward_terms`), in truth. An
    episode ends when the needle has left the field of view for 3 s (``info["end"] == "lost"``),
    the force is above 10 N ("force"), the guard has held the robot for 5 s ("stopped"), or the
    needle rests, centred and aligned to 1 mm and 1 deg for a second ("reached").

    Parameters
    ----------
    observation
        "features": ten numbers as the servo sees them, `FEATURES`, from the tracker's estimate and
        the wrist's sensor; "slices": the same, and the two middle planes of the newest volume;
        "volume": the same, and the newest volume.
    scenario
        Name or path of a scenario of following.
    changes
        Fields of the scenario to change, as of `load_scenario`.
    randomize
        Strength up to which the dials of the harder world are drawn, each in half of the episodes:
        0 for none, 1 for the moderate one.
    reward
        Scales and limits.
    render_mode
        None, or "rgb_array" for the two middle planes.

    Raises
    ------
    ConfigurationError
        If an argument is not allowed.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 3}

    def __init__(
        self,
        observation: str = "features",
        scenario: str = "chatelain2013_fig5",
        changes: Mapping[str, Any] | Sequence[str] = (),
        randomize: float = 0.0,
        reward: RewardParameters | None = None,
        render_mode: str | None = None,
    ) -> None:
        if observation not in OBSERVATIONS:
            allowed = ", ".join(OBSERVATIONS)
            raise ConfigurationError(f"observation: {observation!r}; one of {allowed}")
        if not 0 <= randomize <= 2:
            raise ConfigurationError(f"randomize: {randomize} is not allowed; from 0 to 2")
        self._kind, self._name = observation, scenario
        if isinstance(changes, Mapping):
            changes = [f"{path}={json.dumps(value)}" for path, value in changes.items()]
        self._changes, self._randomize = list(changes), randomize
        self._scale, self._limits = ActionScale(), reward or RewardParameters()
        plain = self._load([], 0)
        self._period = tracker_events(plain)["period"]
        geometry = sweep_geometry(load_transducer(plain.probe), plain.imaging)
        self._shape = make_grid(geometry, plain.scan_conversion.spacing).shape
        self._geometry = geometry
        self.experiment: FollowingExperiment
        super().__init__(
            simulator=self._make_simulator,
            time_step=self._period,
            action_space=Box(-1, 1, (4,), np.float32),
            observation_space=self._space(),
            reward=lambda _, context: float(np.mean(list(self._terms(context).values()))),
            action_port_id="action",
            observation_port_id="observation",
            reset_handler=self._land,
        )
        self.render_mode = render_mode
        self.metadata["render_modes"] = ["rgb_array"]  # the base class has its own
        self.info_handler = lambda simulator: self._info(simulator.get_context())

    def _load(self, changes: Sequence[str], seed: int) -> FollowingScenario:
        loaded = load_scenario(self._name, changes=[*changes, *self._changes], seed=seed)
        return require_scenario(loaded, FollowingScenario)

    def _space(self) -> gymnasium.Space[Any]:
        nx, ny, nz = self._shape
        features = Box(-_LARGEST, _LARGEST, dtype=np.float32)
        if self._kind == "features":
            return features
        if self._kind == "volume":
            return DictSpace({"features": features, "volume": Box(0, 255, (nx, ny, nz), np.uint8)})
        return DictSpace({
            "features": features,
            "along": Box(0, 255, (ny, nx), np.uint8),
            "across": Box(0, 255, (ny, nz), np.uint8),
        })  # fmt: skip

    # An episode.

    def _make_simulator(self, _: Any) -> Simulator:
        """Return the simulator of a new episode, whose seed the environment's generator draws."""
        seed = int(self.np_random.integers(1 << 31))
        scenario = self._load(self._drawn_dials(), seed)
        self._velocity = CommandedVelocity()
        sources = planned_sources(scenario, make_insertion(scenario))
        self._settings = MakeCommandedSettings(schedule=scenario.controller_schedule)
        sources["controller_settings"] = self._settings
        self.experiment = FollowingExperiment(scenario, sources=sources, search=self._velocity)
        self._lost, self._reached, self._end, self._shown = 0.0, 0.0, "", False
        return self.experiment.simulator

    def _drawn_dials(self) -> list[str]:
        if not self._randomize:
            return []
        changes: list[str] = []
        taken: set[str] = set()
        for _, dial, strength in draw_dials_on(self.np_random):
            if not taken & dial.moderate.keys():
                taken |= dial.moderate.keys()
                changes += dial.changes(strength * self._randomize)
        return changes

    def _setup(self) -> None:
        """Use the subsystems' ports: the action goes to the controller, the rest is computed."""
        self.action_port, self.observation_port = _Port(self._act), _Port(self._observe)

    def _land(self, simulator: Simulator, context: Context, _: int | None) -> None:
        """Let the robot land, until the hand begins or for 3 s, and end right after a volume."""
        self._act(context, np.array([0, 0, 0, -1 / 3], np.float32))
        hand = self.experiment.scenario.hand.start
        until = 3.0 if hand is None else max(2.0, min(hand, 5.0))
        offset = tracker_events(self.experiment.scenario)["offset"]
        steps = max(0, round((until - offset) / self._period))
        simulator.Initialize()
        simulator.AdvanceTo(offset + steps * self._period + 5 * INSTANT)

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Command for one volume; see `gymnasium.Env.step`. ValueError for no four numbers."""
        numbers = np.asarray(action, float)
        require(
            numbers.shape == (4,) and bool(np.isfinite(numbers).all()),
            "action",
            action,
            "four numbers; beyond -1 and 1 they count as these",
        )
        observation, reward, _, truncated, info = super().step(action)
        if not truncated:
            self._end = self._judge(self.experiment.simulator.get_context())
            info["end"] = self._end
        return observation, float(reward), bool(self._end), truncated, info

    def close(self) -> None:
        """Forget the episode."""
        self.simulator = None

    def render(self) -> NDArray[np.uint8] | None:
        """Return the two middle planes of the newest volume side by side, in ``rgb_array`` mode."""
        if self.render_mode != "rgb_array":
            return None
        along, across = self._planes()
        return np.repeat(np.hstack([along, across])[..., np.newaxis], 3, axis=2)

    # What the agent does and sees.

    def _act(self, context: Context, action: NDArray[np.float32]) -> None:
        velocity, force = self._scale.command(action)
        own = self._velocity.GetMyMutableContextFromRoot(context)
        self._velocity.GetInputPort("agent_velocity").FixValue(own, velocity)
        passing = self._settings.GetSubsystemByName("agent_force")
        passing.get_input_port().FixValue(passing.GetMyMutableContextFromRoot(context), [force])

    def _observe(self, context: Context) -> Any:
        features = self._features()
        if self._kind == "features":
            return features
        if self._kind == "volume":
            return {"features": features, "volume": self._grey()}
        along, across = self._planes()
        return {"features": features, "along": along, "across": across}

    def _features(self) -> NDArray[np.float32]:
        experiment, seen = self.experiment, np.zeros(len(FEATURES))
        estimate: NeedleEstimate = experiment.estimate
        seen[8] = float(experiment.evaluate(experiment.probe_controller, "pressing_force")[0])
        seen[6] = estimate.probability
        if estimate.curve is not None:
            X_PW = experiment.evaluate(experiment.station, "X_WP").inverse()
            entry, tip = X_PW.multiply(estimate.curve.position([0, 1]).T).T
            x, z, seen[2] = needle_features(tip, tip - entry)
            speed = X_PW.rotation().multiply(estimate.tip_velocity)
            seen[[0, 1, 3, 4, 5]] = 100 * np.array([x, z, speed[0], speed[2], estimate.tip_std])
            seen[7] = estimate.mode is TrackingMode.TRACKING
            seen[9] = experiment.time - estimate.time
        return np.clip(seen, -_LARGEST, _LARGEST).astype(np.float32)

    def _grey(self) -> NDArray[np.uint8]:
        volume = self.experiment.evaluate(self.experiment.scan_converter, "volume")
        if not isinstance(volume, Volume):
            return np.zeros(self._shape, np.uint8)
        return np.rint(volume.intensities).astype(np.uint8)

    def _planes(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        grey = self._grey()
        return grey[:, :, grey.shape[2] // 2].T.copy(), grey[grey.shape[0] // 2].copy()

    def expert_action(self) -> NDArray[np.float32]:
        """Return what the robot's own servo would do now."""
        experiment = self.experiment
        velocity = experiment.evaluate(experiment.probe_controller, "planar_velocity")
        return self._scale.action(velocity, experiment.scenario.controller.settings.force)

    # The truth.

    def _truth(self) -> tuple[NDArray[np.float64], float, float]:
        """Return the true features of the needle, its length in view in m, and the force in N."""
        experiment = self.experiment
        X_WP = experiment.evaluate(experiment.station, "true_X_WP")
        X_PT = X_WP.InvertAndCompose(experiment.evaluate(experiment.station, "X_WT"))
        scanner = experiment.scanner
        needle: Needle = scanner.GetInputPort("needle").Eval(experiment.context_of(scanner))
        needle = needle.transformed(X_PT)
        force = float(experiment.evaluate(experiment.station, "contact_force")[0])
        if not needle:
            return np.full(3, np.nan), 0.0, force
        features = needle_features(needle.tip, needle.curve.direction)
        return features, visible_length(needle, self._geometry), force

    def _terms(self, _: Context) -> dict[str, float]:
        features, visible, force = self._truth()
        return reward_terms(features, force, visible > 0, self._limits)

    def _info(self, context: Context) -> dict[str, Any]:
        return {
            "time_s": context.get_time(),
            "seed": self.experiment.scenario.seed,
            "reward_terms": self._terms(context),
            "contact_force": self._truth()[2],
            "end": self._end,
        }

    def _judge(self, context: Context) -> str:
        """Return why the episode ends; empty if it goes on."""
        features, visible, force = self._truth()
        limits = self._limits
        if force > limits.max_force:
            return "force"
        controller = self.experiment.probe_controller
        if controller.HasOutputPort("guard"):
            guard: GuardStatus = self.experiment.evaluate(controller, "guard")
            if guard.stopped and context.get_time() - guard.since > _STOPPED:
                return "stopped"
        there = bool(np.isfinite(features).all())
        self._shown = there and (self._shown or visible > 0)
        self._lost = self._lost + self._period if self._shown and not visible else 0.0
        if self._lost >= limits.lost_after:
            return "lost"
        offset, angle = limits.reached
        hand = self.experiment.scenario.hand
        inserted = (hand.start or 0.0) + sum(push.duration for push in hand.pushes)
        near = there and np.hypot(*features[:2]) < offset and abs(features[2]) < angle
        done = near and context.get_time() > inserted
        self._reached = self._reached + self._period if done else 0.0
        return "reached" if self._reached >= limits.reached_after else ""


class _Port:
    """A port of `DrakeGymEnv` that is a function of the environment."""

    def __init__(self, function: Any) -> None:
        self._function = function

    def FixValue(self, context: Context, value: Any) -> None:
        self._function(context, value)

    def Eval(self, context: Context) -> Any:
        return self._function(context)


if ENVIRONMENT not in gymnasium.registry:
    gymnasium.register(
        id=ENVIRONMENT, entry_point=f"{__name__}:{FollowNeedle.__name__}", max_episode_steps=90
    )
