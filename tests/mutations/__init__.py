"""Faults that once survived the tests, as patches; `make mutations` shows each one killed."""
