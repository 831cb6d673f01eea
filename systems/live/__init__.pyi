from .connection.address import parse_address as parse_address
from .connection.link import Link as Link
from .feeds import NeedleNames as NeedleNames
from .live_source import LiveSource as LiveSource
from .motor_sweep import MotorSweepParameters as MotorSweepParameters
from .sender import Sender as Sender
from .volume_receiver import VolumeReceiver as VolumeReceiver
