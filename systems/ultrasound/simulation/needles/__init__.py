"""Echo of a needle: levels, surface of the tip, and rendering."""
