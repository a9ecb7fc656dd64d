"""Longer runs: coverage-guided fuzzing, bad lines, hostile clients, failing machines."""
