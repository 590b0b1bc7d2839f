"""A plug-in for imud."""
