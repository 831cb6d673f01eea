from .pose_corrector import HandEyeCorrector as HandEyeCorrector
from .pose_corrector import PoseCorrector as PoseCorrector
from .pose_errors import estimate_pose_errors as estimate_pose_errors
