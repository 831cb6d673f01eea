"""Commands that exchange data with other programs: serve a run, track and bridge live volumes.

Only the command line's modules import this room.
"""
