"""Reaction of the tissue to probe and needle: indentation, drag and displaced volume."""
