"""The environment: Gymnasium's own check, repetition bit for bit, ends, and vectors."""

import sys
from collections import Counter
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pydrake.math import RigidTransform

from sonoservo.diagrams import environment
from sonoservo.diagrams.environment import RewardParameters
from sonoservo.diagrams.environment.follow_needle import ENVIRONMENT
from sonoservo.diagrams.environment.reward import ActionScale, reward_terms
from sonoservo.systems.files.refusals import ConfigurationError

CHANGES = {
    "hand.start": 0.0,
    "hand.pushes": [{"duration": 2.0, "speed": 0.04}, {"duration": 10.0, "speed": 0.0}],
    "station.plant.contact_model": "point",
    "scan_conversion.spacing": [3e-3, 3e-3, 3e-3],
    "imaging": {"frame_pitch_deg": 9.0, "frames": 5, "sector": 0.3, "depth": 0.05},
}
"""A small and coarse image, since what is tested is not in it."""


# Gymnasium imports what stands before the colon, also in processes that know nothing else.
make = partial(gymnasium.make, f"sonoservo.diagrams.environment:{ENVIRONMENT}", changes=CHANGES)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*render.*")
def test_gymnasium_finds_nothing_wrong():
    check_env(make(observation="slices", render_mode="rgb_array").unwrapped,
              skip_render_check=True)  # fmt: skip


def test_an_episode_is_repeated_bit_for_bit_from_seed_and_actions():
    actions = np.random.default_rng(4).uniform(-1, 1, (3, 4)).astype(np.float32)
    env, seen = make(randomize=1.0), []
    for _ in range(2):
        observation, info = env.reset(seed=11)
        steps = [env.step(action)[:2] for action in actions]
        seen.append(
            [info["seed"], *observation, *(each for pair in steps for each in (*pair[0], pair[1]))]
        )
    np.testing.assert_array_equal(*seen)


def test_the_agent_moves_the_probe_and_presses_it():
    env = make()
    env.reset(seed=3)
    experiment = env.unwrapped.experiment
    before = RigidTransform(experiment.evaluate(experiment.station, "true_X_WP"))
    scale = ActionScale()
    for _ in range(4):
        *_, info = env.step(scale.action(np.array([0.01, 0.0, 0.0]), 3.0))
    moved = before.InvertAndCompose(experiment.evaluate(experiment.station, "true_X_WP"))
    assert moved.translation()[0] == pytest.approx(0.01 * 4 * env.unwrapped.time_step, rel=0.15)
    assert info["contact_force"] == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize(
    ("seed", "steps", "lost_after"),
    [(1, 6, 0.5), *(pytest.param(k, 1000, 3.0, marks=pytest.mark.slow) for k in range(100, 110))],
)
def test_random_actions_end_in_no_error_and_below_the_limit_of_the_force(seed, steps, lost_after):
    env = make(randomize=1.0, reward=RewardParameters(lost_after=lost_after))
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    largest, ends, action = 0.0, Counter(), rng.choice([-1, 1], 4).astype(np.float32)
    for _ in range(steps):
        if rng.random() < 0.3:  # kept for a second: what is drawn anew each time leads nowhere
            action = rng.choice([rng.uniform(-1, 1, 4), rng.choice([-1, 1], 4)]).astype(np.float32)
        _, reward, ended, cut, info = env.step(action)
        assert 0 <= reward <= 1
        largest = max(largest, info["contact_force"])
        if ended or cut:
            ends[info.get("end") or "cut"] += 1
            env.reset()
    print(f"seed {seed}: {largest:.2f} N, {dict(ends)}")
    assert largest < 10  # the guard's limit
    assert set(ends) <= {"lost", "stopped", "reached", "cut"}


@pytest.mark.slow
def test_environments_run_in_processes_of_their_own_found_by_the_room_s_name():
    vector = gymnasium.vector.AsyncVectorEnv([make, make], context="spawn")
    try:
        first, info = vector.reset(seed=[1, 2])
        assert info["seed"][0] != info["seed"][1]
        assert first.shape == (2, 10)
        alone, _ = make().reset(seed=2)
        np.testing.assert_array_equal(first[1], alone)
    finally:
        vector.close()


def test_the_terms_of_the_reward_fall_to_half_at_their_scales():
    scales = RewardParameters()
    perfect = reward_terms(np.zeros(3), 2.0, True, scales)
    assert set(perfect.values()) == {1.0}
    off = reward_terms(np.array([3e-3, 4e-3, np.deg2rad(10)]), 3.0, True, scales)
    assert off["centred"] == off["aligned"] == off["pressed"] == pytest.approx(0.5)
    none = reward_terms(np.full(3, np.nan), 2.0, False, scales)
    assert none == {"centred": 0, "aligned": 0, "in_view": 0, "pressed": 1}


def test_an_action_commands_what_it_was_made_of():
    scale = ActionScale()
    velocity, force = scale.command(scale.action(np.array([0.01, -0.02, 0.1]), 2.5))
    np.testing.assert_allclose(velocity, [0.01, -0.02, 0.1], rtol=1e-6)
    assert force == pytest.approx(2.5)
    assert scale.command(np.array([2, 5, -5, 9]))[1] == 4.0


def test_a_wrong_argument_is_refused():
    with pytest.raises(ConfigurationError, match="observation: 'pixels'"):
        make(observation="pixels")
    for action in ([np.nan, 0, 0, 0], [0, 0, 0]):
        with pytest.raises(ValueError, match="action: .* is not allowed; it must be four numbers"):
            make().unwrapped.step(action)


def test_without_gymnasium_a_line_says_what_to_install(monkeypatch):
    monkeypatch.delattr(environment, "FollowNeedle", raising=False)  # once asked for, it is kept
    monkeypatch.delitem(sys.modules, "sonoservo.diagrams.environment.follow_needle")
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'sonoservo\[gym\]'"):
        environment.FollowNeedle  # noqa: B018
