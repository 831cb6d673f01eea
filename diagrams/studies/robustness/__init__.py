"""Study of robustness: performance of the trackers as the dials of the harder world are turned."""
