# %% [markdown]
# # Learn to follow
#
# This notebook uses the loop as a Gymnasium environment (extra `gym`). The agent sees ten features,
# as the robot's servo does, and moves the probe. An action is the velocities along X and Z, the
# angular velocity about Y and the target force, each scaled to -1 to 1. The reward is 1 if the
# needle is centred, aligned and in view, and the force is right.
#
# A small policy, without a neural network, learns from the servo in some five minutes on two cores:
# by behaviour cloning, and one round in which the servo corrects what the policy does (DAgger).

# %%
# %matplotlib inline
import os

import matplotlib.pyplot as plt
import numpy as np

from sonoservo.diagrams.environment import FollowNeedle
from sonoservo.diagrams.environment.follow_needle import FEATURES

quick = os.environ.get("SONOSERVO_QUICK", "").split()  # what the tests change, to be done sooner
steps = 3 if quick else 45
changes = ["hand.start=1.0", *quick]
environment = FollowNeedle(changes=changes)  # or gymnasium.make("sonoservo/FollowNeedle-v0")

# %% [markdown]
# This runs an episode with a policy. In every step, the servo says what it would have done; `share`
# is the fraction of steps in which it acts itself.

# %%
rng = np.random.default_rng(0)
TRACKED = FEATURES.index("tracked")


def episode(policy, seed, share=0.0):
    """Return features, the servo's actions and the rewards of an episode."""
    features, _ = environment.reset(seed=seed)
    seen, expert, rewards = [], [], []
    for _ in range(steps):
        wanted = environment.expert_action()
        seen.append(features)
        expert.append(wanted)
        action = wanted if rng.random() < share else policy(features)
        features, reward, ended, cut, _ = environment.step(action)
        rewards.append(reward)
        if ended or cut:
            break
    return np.array(seen), np.array(expert), np.array(rewards)


# %% [markdown]
# The policy is linear in the features and in their products with `tracked`, so that it can hold
# still while nothing is tracked. It is fitted by ridge regression.


# %%
def terms(features):
    """Return the regressors of a policy."""
    features = np.atleast_2d(features)
    return np.hstack([features, features * features[:, [TRACKED]], np.ones((len(features), 1))])


def fitted(seen, expert):
    """Return the policy that fits the servo's actions best."""
    X = terms(seen)
    weights = np.linalg.solve(X.T @ X + 1e-2 * np.eye(X.shape[1]), X.T @ expert)
    return lambda features: np.clip(terms(features)[0] @ weights, -1, 1).astype(np.float32)


demonstrations = [episode(None, seed, share=1.0)[:2] for seed in (range(1) if quick else (1, 2))]
cloned = fitted(*map(np.concatenate, zip(*demonstrations, strict=True)))
corrected = [*demonstrations, episode(cloned, 3, share=0.3)[:2]]
policy = fitted(*map(np.concatenate, zip(*corrected, strict=True)))

# %% [markdown]
# Compare the policies with the servo on an episode that none has seen:

# %%
rewards = {
    "servo": episode(None, 9, share=1.0)[2],
    "cloned": episode(cloned, 9)[2],
    "cloned and corrected": episode(policy, 9)[2],
}
for name, each in rewards.items():
    plt.plot(each, label=f"{name}: {each.mean():.2f} in the mean")
plt.xlabel("volume")
plt.ylabel("reward")
plt.legend()
plt.show()

# %% [markdown]
# One episode proves little; average over many. The policy acts once per volume, whereas the servo
# extrapolates the needle's motion a hundred times a second. It has no reason to hold when the
# estimate is stale or uncertain, and it only knows the insertions that it was shown.
# `randomize=1.0` turns the dials of the harder world at random.
