from .cross_section import CrossSectionParameters as CrossSectionParameters
from .cross_section_localizer import CrossSectionLocalizer as CrossSectionLocalizer
from .cross_section_memory import CrossSectionMemory as CrossSectionMemory
from .measurement_noise import MeasurementNoise as MeasurementNoise
from .published_particle_filter import PublishedBelief as PublishedBelief
from .published_particle_filter import PublishedParticleFilter as PublishedParticleFilter
from .published_particle_filter import (
    PublishedParticleFilterParameters as PublishedParticleFilterParameters,
)
from .shape_estimator import ShapeEstimator as ShapeEstimator
from .shape_filter import ShapeFilter as ShapeFilter
from .shape_filter import ShapePaths as ShapePaths
from .shape_filters import ShapeFilterChoice as ShapeFilterChoice
from .shape_least_squares import FittedShape as FittedShape
from .shape_least_squares import ShapeLeastSquares as ShapeLeastSquares
from .shape_least_squares import ShapeLeastSquaresParameters as ShapeLeastSquaresParameters
from .shape_parameters import ShapeEstimatorParameters as ShapeEstimatorParameters
from .shape_particle_filter import ParticleBelief as ParticleBelief
from .shape_particle_filter import ShapeParticleFilter as ShapeParticleFilter
from .shape_posterior import Moments as Moments
from .shape_posterior import ShapeParticleFilterParameters as ShapeParticleFilterParameters
from .shape_posterior import ShapePosterior as ShapePosterior
from .shape_posterior import WanderParameters as WanderParameters
from .shape_posterior import combined_wander as combined_wander
