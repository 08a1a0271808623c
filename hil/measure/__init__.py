"""Numbers of a run, no pictures."""
