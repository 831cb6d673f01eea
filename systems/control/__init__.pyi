from .controller_schedule import ControllerChange as ControllerChange
from .controller_schedule import ControllerSchedule as ControllerSchedule
from .controller_schedule import ControllerSettings as ControllerSettings
from .differential_kinematics import DifferentialKinematics as DifferentialKinematics
from .differential_kinematics import (
    DifferentialKinematicsParameters as DifferentialKinematicsParameters,
)
from .differential_kinematics import probe_twist as probe_twist
from .force_controller import ForceController as ForceController
from .force_law import ForceControllerParameters as ForceControllerParameters
from .force_law import ForceState as ForceState
from .force_law import approach_velocity as approach_velocity
from .force_law import pressing_force as pressing_force
from .guard import Guard as Guard
from .guard_parameters import GuardParameters as GuardParameters
from .guard_parameters import WristSensorLimits as WristSensorLimits
from .operator_settings import OperatorSettings as OperatorSettings
from .scheduled_settings import ScheduledSettings as ScheduledSettings
from .visual_features import interaction_matrix as interaction_matrix
from .visual_features import needle_features as needle_features
from .visual_features import servo_velocity as servo_velocity
from .visual_servo import VisualServo as VisualServo
from .visual_servo import VisualServoParameters as VisualServoParameters
from .visual_servo import planar_velocity as planar_velocity
