from .calibration import CalibrationParameters as CalibrationParameters
from .pose_delay import PoseDelay as PoseDelay
from .pose_delay import PoseDelayParameters as PoseDelayParameters
from .sensor_faults import SensorFault as SensorFault
from .sensor_faults import SensorFaults as SensorFaults
