"""An environment of Gymnasium: a robot follows a needle, and an agent in place of the servo.

The environment is registered when this package, or one of its names, is imported:
``gymnasium.make("sonoservo.diagrams.environment:sonoservo/FollowNeedle-v0")``.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

ENVIRONMENT = "sonoservo/FollowNeedle-v0"
"""Name of the environment."""

try:
    import gymnasium as _gymnasium
except ModuleNotFoundError:  # without the extra gym, the names of this package say what to install
    pass
else:
    _gymnasium.register(
        id=ENVIRONMENT,
        entry_point="sonoservo.diagrams.environment.follow_needle:FollowNeedle",
        max_episode_steps=90,
    )
