"""A second needle, or a guide wire, at rest in the tissue."""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.structures.structure import Structure, up_to


@dataclass(kw_only=True)
class RestingNeedle(Structure):
    """A straight needle at rest; a thin one without reverberation represents a guide wire.

    Parameters
    ----------
    start, end
        Entry and tip in T, in m.
    diameter
        Outer diameter, in m; 1.27 mm is gauge 18, 0.89 mm is a guide wire.
    echo
        Parameters of the needle's echo.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("start", "end")

    kind: str = "needle"
    start: list[float] = field(default_factory=lambda: [-0.04, 0.0, -0.03])
    end: list[float] = field(default_factory=lambda: [0.02, 0.0, -0.05])
    diameter: Annotated[float, up_to(5e-3)] = 1.27e-3
    echo: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start != self.end, "end", self.end, "another point than start")

    @property
    def reach(self) -> float:
        """Radius of the needle, in m."""
        return self.diameter / 2

    def needle(self) -> Needle:
        """Return the needle in T."""
        return Needle(np.array([self.start, self.end]), self.diameter / 2)
