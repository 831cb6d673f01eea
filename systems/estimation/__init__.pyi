from .axis_tip_filter import AxisTipFilter as AxisTipFilter
from .axis_tip_filter import AxisTipFilterParameters as AxisTipFilterParameters
from .axis_tip_filter import AxisTipTrack as AxisTipTrack
from .axis_tip_state import AxisTipState as AxisTipState
from .axis_tip_state import direction_angles as direction_angles
from .axis_tip_state import predict_axis_tip as predict_axis_tip
from .axis_tip_state import start_axis_tip as start_axis_tip
from .axis_tip_state import update_axis_tip as update_axis_tip
from .least_squares_shape_estimator import LeastSquaresShapeEstimator as LeastSquaresShapeEstimator
from .needle_kalman_filter import NeedleKalmanFilter as NeedleKalmanFilter
from .needle_kalman_filter import NeedleKalmanFilterParameters as NeedleKalmanFilterParameters
from .needle_kalman_filter import innovation_distance as innovation_distance
from .needle_kalman_filter import restart_track as restart_track
from .needle_kalman_filter import start_track as start_track
from .needle_kalman_filter import update_track as update_track
from .particle_shape_estimator import ParticleShapeEstimator as ParticleShapeEstimator
from .published_particle_filter import PublishedBelief as PublishedBelief
from .published_particle_filter import (
    PublishedParticleFilterParameters as PublishedParticleFilterParameters,
)
from .published_shape_estimator import PublishedShapeEstimator as PublishedShapeEstimator
from .shape_estimator import ShapeEstimator as ShapeEstimator
from .shape_least_squares import FittedShape as FittedShape
from .shape_least_squares import ShapeFit as ShapeFit
from .shape_least_squares import ShapeLeastSquaresParameters as ShapeLeastSquaresParameters
from .shape_parameters import ShapeEstimatorParameters as ShapeEstimatorParameters
from .shape_particle_filter import ParticleBelief as ParticleBelief
from .shape_particle_filter import ShapeParticleFilterParameters as ShapeParticleFilterParameters
from .shape_particle_filter import ShapePosterior as ShapePosterior
from .shape_posterior import MeasurementNoise as MeasurementNoise
from .track import NeedleMotionParameters as NeedleMotionParameters
from .track import NeedleTrack as NeedleTrack
from .track import constant_velocity as constant_velocity
