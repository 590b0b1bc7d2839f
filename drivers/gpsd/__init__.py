"""A gpsd that runs already, as a receiver."""
