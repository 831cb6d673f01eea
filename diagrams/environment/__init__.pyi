from .commanded_velocity import CommandedVelocity as CommandedVelocity
from .follow_needle import FollowNeedle as FollowNeedle
from .reward import MakeCommandedSettings as MakeCommandedSettings
from .reward import RewardParameters as RewardParameters
