"""CSV tables, in and out."""
