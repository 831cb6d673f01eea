"""Many runs: studies and data sets."""
