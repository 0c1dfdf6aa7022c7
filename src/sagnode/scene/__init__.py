"""Renders frames of exact catenaries with the truth beside them, for the demonstration, tests and benchmarks."""
