"""What streams on a port: an inertial sensor or a receiver, as the daemon and the replay see it."""
