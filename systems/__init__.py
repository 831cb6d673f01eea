"""Building blocks: one Drake system a file, beside the pure functions it calls."""

from sonoservo.systems.sampling.threads import limit_threads

limit_threads()
