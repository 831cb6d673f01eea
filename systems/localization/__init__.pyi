from .axis import Axis as Axis
from .axis import axis_through as axis_through
from .axis_fit import AxisFit as AxisFit
from .axis_fit import fit_axis as fit_axis
from .candidates import Candidates as Candidates
from .candidates import select_candidates as select_candidates
from .cross_section import CrossSectionParameters as CrossSectionParameters
from .cross_section_localizer import CrossSectionLocalizer as CrossSectionLocalizer
from .edge_velocimeter import EdgeVelocimeterParameters as EdgeVelocimeterParameters
from .edge_velocimeter import measure_edge_velocity as measure_edge_velocity
from .intensity_drop import intensity_drops as intensity_drops
from .line_search import bright_lines as bright_lines
from .local_optimization import optimize_locally as optimize_locally
from .localizer_parameters import NeedleLocalizerParameters as NeedleLocalizerParameters
from .needle_line import NeedleLine as NeedleLine
from .needle_line import needle_lines as needle_lines
from .needle_localizer import NeedleLocalizer as NeedleLocalizer
from .normalized_cross_correlation import Match as Match
from .normalized_cross_correlation import best_match as best_match
from .pipeline import explain_localization as explain_localization
from .pipeline import localize as localize
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
