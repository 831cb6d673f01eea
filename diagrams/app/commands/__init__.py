"""Commands of the program, by subject."""
