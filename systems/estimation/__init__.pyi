from .axis_tip_filter import AxisTipFilter as AxisTipFilter
from .axis_tip_filter import AxisTipState as AxisTipState
from .axis_tip_filter import direction_angles as direction_angles
from .control_point_filter import ControlPointFilter as ControlPointFilter
from .control_point_filter import ControlPointState as ControlPointState
from .innovation_gate import innovation_distance as innovation_distance
from .lifecycle import Lifecycle as Lifecycle
from .needle_filter import NeedleFilter as NeedleFilter
from .needle_filter import NeedleState as NeedleState
from .needle_motion import NeedleMotionParameters as NeedleMotionParameters
from .needle_motion import constant_velocity as constant_velocity
from .published_lifecycle import PublishedLifecycle as PublishedLifecycle
from .shape.cross_section_memory import CrossSectionMemory as CrossSectionMemory
from .shape.measurement_noise import MeasurementNoise as MeasurementNoise
from .shape.published_particle_filter import PublishedBelief as PublishedBelief
from .shape.published_particle_filter import PublishedParticleFilter as PublishedParticleFilter
from .shape.published_particle_filter import (
    PublishedParticleFilterParameters as PublishedParticleFilterParameters,
)
from .shape.shape_estimator import ShapeEstimator as ShapeEstimator
from .shape.shape_filter import ShapeFilter as ShapeFilter
from .shape.shape_filter import ShapePaths as ShapePaths
from .shape.shape_filters import ShapeFilterChoice as ShapeFilterChoice
from .shape.shape_least_squares import FittedShape as FittedShape
from .shape.shape_least_squares import ShapeLeastSquares as ShapeLeastSquares
from .shape.shape_least_squares import ShapeLeastSquaresParameters as ShapeLeastSquaresParameters
from .shape.shape_parameters import ShapeEstimatorParameters as ShapeEstimatorParameters
from .shape.shape_particle_filter import ParticleBelief as ParticleBelief
from .shape.shape_particle_filter import ShapeParticleFilter as ShapeParticleFilter
from .shape.shape_posterior import Moments as Moments
from .shape.shape_posterior import (
    ShapeParticleFilterParameters as ShapeParticleFilterParameters,
)
from .shape.shape_posterior import ShapePosterior as ShapePosterior
from .shape.shape_posterior import WanderParameters as WanderParameters
from .shape.shape_posterior import combined_wander as combined_wander
from .track import Track as Track
from .track_lifecycle import TrackLifecycle as TrackLifecycle
from .track_manager import TrackManager as TrackManager
from .track_parameters import TrackParameters as TrackParameters
