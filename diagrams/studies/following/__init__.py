"""Studies of runs of following: two methods on the same seeds, judged from their logs."""
