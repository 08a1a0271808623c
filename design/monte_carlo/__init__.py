"""Thousands of runs at once: paths, batches, seeds, parallel back ends, confidence."""
