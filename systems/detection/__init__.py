"""Something moved: volume difference, geometric median, insertion detector."""
