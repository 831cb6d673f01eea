"""Study of robustness: what the trackers survive when the dials of the harder world are turned."""
