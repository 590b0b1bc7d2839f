"""From the configuration file to what runs: settings read and checked; ports, estimator and noise profile chosen."""
