"""What happened in a run, judged against ground truth."""
