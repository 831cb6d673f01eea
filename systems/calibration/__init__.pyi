from .pose_calibration import PoseCalibration as PoseCalibration
from .pose_corrector import PoseCorrector as PoseCorrector
from .pose_errors import PoseEquations as PoseEquations
from .pose_errors import PoseErrors as PoseErrors
from .pose_errors import estimate_pose_errors as estimate_pose_errors
from .pose_errors import pose_equations as pose_equations
from .tissue_displacement import TissueDisplacement as TissueDisplacement
from .tissue_displacement import displacement_between as displacement_between
