from .calibration import CalibrationParameters as CalibrationParameters
from .calibration import hand_eye_error as hand_eye_error
from .calibration import joint_offsets as joint_offsets
from .pose_delay import PoseDelay as PoseDelay
from .pose_delay import PoseDelayParameters as PoseDelayParameters
from .sensor_faults import SensorFault as SensorFault
from .sensor_faults import SensorFaults as SensorFaults
from .sensor_faults import add_sensor_faults as add_sensor_faults
