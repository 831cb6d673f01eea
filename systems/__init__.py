"""Building blocks: one Drake system a file, beside the pure functions it calls."""

from sonoservo.systems.sampling.libraries import prepare_libraries

prepare_libraries()
