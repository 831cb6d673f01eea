from .bright_points import inclusion_points as inclusion_points
