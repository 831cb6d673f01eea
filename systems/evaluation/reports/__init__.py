"""Reports of runs: verdict, plots, key frames, pages and movies."""
