"""The world view, drawn with Drake's Meshcat."""
