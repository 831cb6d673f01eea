from .commanded_velocity import CommandedVelocity as CommandedVelocity
from .commands import MakeCommandedSettings as MakeCommandedSettings
from .follow_needle import FollowNeedle as FollowNeedle
