from .axis import Axis as Axis
from .axis import axis_through as axis_through
from .axis_fit import AxisFit as AxisFit
from .axis_fit import fit_axis as fit_axis
from .axis_tip_filter import AxisTipFilter as AxisTipFilter
from .axis_tip_filter import AxisTipState as AxisTipState
from .axis_tip_filter import direction_angles as direction_angles
from .candidates import Candidates as Candidates
from .candidates import select_candidates as select_candidates
from .control_point_filter import ControlPointFilter as ControlPointFilter
from .control_point_filter import ControlPointState as ControlPointState
from .edge_velocimeter import EdgeVelocimeterParameters as EdgeVelocimeterParameters
from .edge_velocimeter import measure_edge_velocity as measure_edge_velocity
from .field_of_view import closest_face as closest_face
from .innovation_gate import innovation_distance as innovation_distance
from .insertion_detector import InsertionDetector as InsertionDetector
from .intensity_drop import intensity_drops as intensity_drops
from .lifecycle import Lifecycle as Lifecycle
from .line_belief import LineBelief as LineBelief
from .line_belief import follow as follow
from .line_follower import LineFollower as LineFollower
from .local_optimization import optimize_locally as optimize_locally
from .localizer_parameters import NeedleLocalizerParameters as NeedleLocalizerParameters
from .needle_filter import NeedleFilter as NeedleFilter
from .needle_filter import NeedleState as NeedleState
from .needle_line import NeedleLine as NeedleLine
from .needle_line import needle_lines as needle_lines
from .needle_localizer import NeedleLocalizer as NeedleLocalizer
from .needle_motion import NeedleMotionParameters as NeedleMotionParameters
from .needle_motion import constant_velocity as constant_velocity
from .pipeline import explain_localization as explain_localization
from .pipeline import localize as localize
from .published_detection import PublishedDetectionParameters as PublishedDetectionParameters
from .published_detection import detect_as_published as detect_as_published
from .published_lifecycle import PublishedLifecycle as PublishedLifecycle
from .published_localization import (
    PublishedLocalizationParameters as PublishedLocalizationParameters,
)
from .published_localization import (
    explain_published_localization as explain_published_localization,
)
from .ransac import RansacParameters as RansacParameters
from .ransac import RansacResult as RansacResult
from .ransac import ransac_axis as ransac_axis
from .search_region import predicted_region as predicted_region
from .speckle_velocimeter import SpeckleVelocimeter as SpeckleVelocimeter
from .speckle_velocimeter import SpeckleVelocimeterParameters as SpeckleVelocimeterParameters
from .speckle_velocimeter import measure_velocity as measure_velocity
from .speckle_velocimeter import measure_velocity_as_published as measure_velocity_as_published
from .tip import TipParameters as TipParameters
from .tip import axis_profile as axis_profile
from .tip import find_extent as find_extent
from .tip import most_evident_stretch as most_evident_stretch
from .track import Track as Track
from .track_lifecycle import TrackLifecycle as TrackLifecycle
from .track_manager import TrackManager as TrackManager
from .track_parameters import TrackParameters as TrackParameters
from .volume_difference import top_differences as top_differences
from .volume_gate import VolumeGate as VolumeGate
from .volume_memory import VolumeMemory as VolumeMemory
from .volume_plausibility import VolumePlausibilityParameters as VolumePlausibilityParameters
from .whole_volume_ransac import (
    WholeVolumeLocalizationParameters as WholeVolumeLocalizationParameters,
)
from .whole_volume_ransac import WholeVolumeNeedle as WholeVolumeNeedle
from .whole_volume_ransac import WholeVolumeRansacParameters as WholeVolumeRansacParameters
from .whole_volume_ransac import brightest_voxels as brightest_voxels
from .whole_volume_ransac import (
    explain_whole_volume_localization as explain_whole_volume_localization,
)
from .whole_volume_ransac import localize_in_whole_volume as localize_in_whole_volume
