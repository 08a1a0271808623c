"""Benchmarks: always two things measured in one run, always with their ratio; none decides a test."""
