"""The papers' experiments on simulated data: one file per paper, each a function from a seed to a `Report`."""
