"""What a run of needle shape prediction is made of."""

from dataclasses import dataclass, field

from sonoservo.systems.estimation.published_particle_filter import PublishedParticleFilterParameters
from sonoservo.systems.estimation.shape_least_squares import ShapeLeastSquaresParameters
from sonoservo.systems.estimation.shape_particle_filter import ShapeParticleFilterParameters
from sonoservo.systems.files.typed_yaml import dump_typed, suggest
from sonoservo.systems.localization.cross_section_tracker import CrossSectionTrackerParameters
from sonoservo.systems.needle.bevelled_insertion import BevelledInsertionParameters
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.rendering import ScannerParameters

ESTIMATORS = ("particle_filter", "least_squares", "published")
"""Names of the shape estimators."""


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
class ShapeScenario:
    """All of a run in which a needle's shape is predicted from axial slices.

    Every field has a default; a file states what differs.

    Parameters
    ----------
    kind
        "needle_shape": tells such a file from that of a `Scenario`.
    name
        Of the scenario; the file's name where it came from a file.
    description
        One line for lists and reports.
    seed
        Of everything random: tissue, needle, noise, sampling.
    depth
        Of the last slice from the first, in m. It replaces the parts' own.
    rotations
        Depths at which the bevel is turned by 180 deg, in m. They replace the parts' own.
    observe_until
        Depth beyond which the estimator looks at no slice, in m: it then predicts (the paper's D).
        None looks at all. It replaces the parts' own.
    step
        Between slices, in m. Together with the hand's speed it gives the slices per second, which
        replace ``imaging.volume_rate``.
    pixel
        Of the slices, in m.
    face
        z in T of the probe's face, in m; below zero, the tissue surrounds the face.
    tissue_shift
        Standard deviation of the tissue's shift from slice to slice, along each of X and Y of P,
        in m: nobody knows it.
    phantom
        Tissue: name of a file in models/phantoms, or a path.
    probe
        Name of a file in models/probes, or a path.
    imaging, scanner
        The scanner's settings; noise and artefacts.
    hand
        The needle and how it is pushed.
    tracker
        Of the cross-section.
    estimator
        That guides the tracker: "particle_filter", "least_squares" or "published".
    particle_filter, least_squares, published
        Parameters of each.
    processing_time
        From a slice to the estimate that it gives, in s.
    published_figures
        Of the publication, shown beside ours: dotted paths into the summary.
    """

    kind: str = "needle_shape"
    name: str = "unnamed"
    description: str = ""
    seed: int = 0
    depth: float = 0.14
    rotations: list[float] = field(default_factory=list)
    observe_until: float | None = None
    step: float = 0.5e-3
    pixel: float = 0.2e-3
    face: float = -2e-3
    tissue_shift: float = 0.1e-3
    phantom: str = "beef"
    probe: str = "trus"
    imaging: ImagingParameters = field(default_factory=_imaging)
    scanner: ScannerParameters = field(default_factory=ScannerParameters)
    hand: BevelledInsertionParameters = field(default_factory=BevelledInsertionParameters)
    tracker: CrossSectionTrackerParameters = field(default_factory=CrossSectionTrackerParameters)
    estimator: str = "particle_filter"
    particle_filter: ShapeParticleFilterParameters = field(
        default_factory=ShapeParticleFilterParameters
    )
    least_squares: ShapeLeastSquaresParameters = field(default_factory=ShapeLeastSquaresParameters)
    published: PublishedParticleFilterParameters = field(
        default_factory=PublishedParticleFilterParameters
    )
    processing_time: float = 0.01
    published_figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.kind == "needle_shape", "kind", self.kind, '"needle_shape"')
        plain = self.name.strip() and not set(self.name) & set("/\\\0")
        require(bool(plain) and self.name not in (".", ".."), "name", self.name, "a plain name")
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        require_positive(
            depth=self.depth,
            step=self.step,
            pixel=self.pixel,
            processing_time=self.processing_time,
        )
        require_not_negative(tissue_shift=self.tissue_shift)
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
        period = self.step / self.hand.speed
        require(
            self.processing_time < period,
            "processing_time",
            self.processing_time,
            f"below the {period:g} s between slices",
        )

    @property
    def period(self) -> float:
        """Between slices, in s."""
        return self.step / self.hand.speed

    @property
    def steps(self) -> int:
        """Number of the stepper's steps; there is one slice more."""
        return round(self.depth / self.step)

    @property
    def duration(self) -> float:
        """Simulated time in s."""
        return (self.steps + 1) * self.period + self.processing_time

    def to_yaml(self) -> str:
        """Return all fields as YAML that `load_scenario` reads."""
        return dump_typed(self)
