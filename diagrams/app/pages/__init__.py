"""The pages of a command, and what they do to its pace."""
