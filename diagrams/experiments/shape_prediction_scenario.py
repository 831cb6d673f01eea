"""Scenarios of shape prediction."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sonoservo.diagrams.published import published
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.needle.insertion_parameters import FeedParameters, InsertionParameters
from sonoservo.systems.shape.cross_section import CrossSectionParameters
from sonoservo.systems.shape.shape_filter import ShapeEstimatorParameters
from sonoservo.systems.shape.shape_filters import SHAPE_FILTERS as OUR_SHAPE_FILTERS
from sonoservo.systems.shape.shape_filters import ShapeFilterChoice
from sonoservo.systems.shape.shape_least_squares import ShapeLeastSquaresParameters
from sonoservo.systems.shape.shape_posterior import ShapeParticleFilterParameters
from sonoservo.systems.signals.requirements import Positive, require, require_not_negative
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_kind import NEEDLE
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters

SHAPE_FILTERS: dict[str, ShapeFilterChoice] = {**OUR_SHAPE_FILTERS, **published("shape_filter")}
"""Name, parameters and filter of every shape estimator, ours and the papers'."""

ESTIMATORS = tuple(SHAPE_FILTERS)
"""Names of the shape estimators; each is also a field of `ShapePredictionScenario`."""

if TYPE_CHECKING:
    PublishedShapeParameters = ShapeEstimatorParameters
else:
    PublishedShapeParameters = SHAPE_FILTERS["published"].parameters

_PUBLISHED_TRACKER = {
    "deviations": "both",
    "position": "match",
    "min_correlation": 0.0,
    "follow_shape_from": 10e-3,
}
"""Search for cross-sections as printed in Carriere 2016, section II."""


def _hand() -> InsertionParameters:
    return InsertionParameters(
        entry=[-0.075, 0.0, -0.030],
        entry_spread=[0.0, 2e-3, 2e-3],
        bend_radius=1.6,
        bend_radius_spread=0.8,
        bend_roll_deg=90.0,
        bend_roll_spread_deg=180.0,
        bend_angle_spread_deg=2.0,
        start=0.0,
        feed=FeedParameters(),
    )


def _imaging() -> ImagingParameters:
    return ImagingParameters(
        gain=0.38,
        depth=0.045,
        sector=0.4,
        transmit_frequency=6.5e6,
        focus_depth=0.03,
        frame_pitch_deg=0.01,
        frames=1,
        sample_pitch=0.1e-3,
    )


@dataclass(kw_only=True)
class ShapePredictionScenario(Scenario):
    """Scenario of a run in which a needle's shape is predicted from axial slices.

    Parameters
    ----------
    experiment
        Name of the experiment, "shape_prediction".
    depth
        Depth of the last slice from the first, in m. It replaces the value in ``hand.feed`` and in
        the estimator's parameters.
    rotations
        Depths at which the bevel is turned by 180 deg, in m. They replace the values in ``hand``
        and in the estimator's parameters.
    observe_until
        Depth beyond which the estimator uses no slice and only predicts (the paper's D), in m. None
        uses all slices. It replaces the value in the estimator's parameters.
    step
        Distance between slices, in m. Together with the feed's speed it sets the number of slices
        per second, which replaces ``imaging.volume_rate``.
    pixel
        Spacing of the slices' pixels, in m.
    face
        Coordinate z in T of the probe's face, in m; below zero, the tissue surrounds the face.
    tissue_shift
        Standard deviation of the tissue's shift from slice to slice, along each of X and Y of P,
        in m; it is unknown to the estimator.
    breathing, breathing_period
        Amplitude in m and period in s of a shift of the tissue by breathing, along a random
        direction across the insertion; it is unknown to the estimator.
    phantom
        Tissue: name of a file in models/phantoms, or a path.
    probe
        Name of a file in models/probes, or a path.
    imaging, scanner
        Settings of the scanner, and parameters of its noise and artefacts.
    needle
        Kind of needle: name of a file in models/needles, or a path. It sets ``hand.gauge`` and
        ``scanner.needle`` where the scenario does not.
    hand
        Needle and its feed through a template.
    tracker
        Settings of the search for cross-sections.
    click_std
        Standard deviation along X and along Y of a person's click on the needle in the first slice,
        in m. None leaves the start to ``tracker``, as does ``tracker.start``.
    estimator
        Name of the shape estimator that guides the search, one of `ESTIMATORS`.
    particle_filter, least_squares, published
        Parameters of each shape estimator.
    processing_time
        Time from a slice to the estimate made from it, in s.
    """

    experiment: str = "shape_prediction"
    depth: Positive = 0.14
    rotations: list[float] = field(default_factory=list)
    observe_until: float | None = None
    step: Positive = 0.5e-3
    pixel: Positive = 0.2e-3
    face: float = -2e-3
    tissue_shift: float = 0.1e-3
    breathing: float = 0.0
    breathing_period: Positive = 4.0
    phantom: str = "beef"
    probe: str = "trus"
    imaging: ImagingParameters = field(default_factory=_imaging)
    scanner: ScannerParameters = field(default_factory=ScannerParameters)
    needle: str = NEEDLE
    hand: InsertionParameters = field(default_factory=_hand)
    tracker: CrossSectionParameters = field(default_factory=CrossSectionParameters)
    click_std: float | None = None
    estimator: str = "particle_filter"
    particle_filter: ShapeParticleFilterParameters = field(
        default_factory=ShapeParticleFilterParameters
    )
    least_squares: ShapeLeastSquaresParameters = field(default_factory=ShapeLeastSquaresParameters)
    published: PublishedShapeParameters = field(
        default_factory=SHAPE_FILTERS["published"].parameters
    )
    processing_time: Positive = 0.01

    @classmethod
    def as_published(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return data with the printed tracker, guided by the printed particle filter."""
        tracker = {**_PUBLISHED_TRACKER, **data.get("tracker", {})}
        return {**data, "estimator": "published", "tracker": tracker}

    def __post_init__(self) -> None:
        super().__post_init__()
        require_not_negative(
            tissue_shift=self.tissue_shift,
            breathing=self.breathing,
            click_std=self.click_std or 0.0,
        )
        require(self.step <= self.depth / 2, "step", self.step, "at most half of depth")
        within = all(0 < each < self.depth for each in self.rotations)
        require(
            within and self.rotations == sorted(set(self.rotations)),
            "rotations",
            self.rotations,
            f"depths in rising order within the insertion, above 0 and below {self.depth} m",
        )
        if self.observe_until is not None:
            require(
                0 < self.observe_until <= self.depth,
                "observe_until",
                self.observe_until,
                f"within the insertion, above 0 and at most {self.depth} m",
            )
        require(
            self.estimator in ESTIMATORS,
            "estimator",
            self.estimator,
            f"one of {', '.join(ESTIMATORS)}; {suggest(self.estimator, ESTIMATORS)}",
        )
        require(self.hand.feed is not None, "hand.feed", None, "a template's feed")
        require(
            self.processing_time < self.period,
            "processing_time",
            self.processing_time,
            f"below the {self.period:g} s between slices",
        )

    @property
    def feed(self) -> FeedParameters:
        """Feed of the needle through the template."""
        assert self.hand.feed is not None
        return self.hand.feed

    @property
    def period(self) -> float:
        """Time between slices, in s."""
        return self.step / self.feed.speed

    @property
    def steps(self) -> int:
        """Number of the stepper's steps, one less than the number of slices."""
        return round(self.depth / self.step)

    @property
    def duration(self) -> float:
        """Simulated time in s, at the end of which the last estimate is made."""
        return (self.steps + 1) * self.period + self.processing_time
