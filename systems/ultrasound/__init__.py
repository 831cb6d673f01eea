"""From the world to volumes: transducer, tissue, echoes, scanner, scan conversion."""
