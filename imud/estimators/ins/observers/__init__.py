"""Observers of the filter: `fusion` calls them at every propagation and at every update."""
