from .clock import ClockParameters as ClockParameters
from .clock import poses_at as poses_at
from .connection import ConnectionParameters as ConnectionParameters
from .connection import Reception as Reception
from .connection import repeat_lost_frames as repeat_lost_frames
from .motor import MotorParameters as MotorParameters
from .motor import motor_error as motor_error
from .motor import turned as turned
