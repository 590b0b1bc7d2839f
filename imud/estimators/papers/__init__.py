"""Estimators of published papers, built as printed where that works: to compare with and to learn from."""
