"""What stands in for a real scanner: tissue, echoes, scanner."""
