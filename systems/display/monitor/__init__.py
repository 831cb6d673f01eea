"""The scanner's monitor: a page of slices."""
