from .controller_schedule import OperatorSettings as OperatorSettings
from .controller_schedule import ScheduledSettings as ScheduledSettings
from .differential_kinematics import DifferentialKinematics as DifferentialKinematics
from .differential_kinematics import (
    DifferentialKinematicsParameters as DifferentialKinematicsParameters,
)
from .force_controller import ForceController as ForceController
from .force_controller import ForceControllerParameters as ForceControllerParameters
from .guard import Guard as Guard
from .guard_parameters import GuardParameters as GuardParameters
from .visual_features import needle_features as needle_features
from .visual_servo import VisualServo as VisualServo
from .visual_servo import VisualServoParameters as VisualServoParameters
