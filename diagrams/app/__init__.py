"""The command line and its commands.

`sonoservo.diagrams` exports the functions behind the commands, such as `run` and `locate`. This
room may import every other.
"""
