"""How blocks are wired: station, tracker, controller, experiment; scenarios, command line."""
