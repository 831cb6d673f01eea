"""Building blocks: one Drake system a file, beside the pure functions it calls."""
