"""Where the probe should go: visual servo, force law, twist to joints."""
