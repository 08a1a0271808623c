"""Discrete-time jump-linear systems, with no network in them: second moments, H2, bounded real, certificates."""
