"""Figures, blocks and pages; knows HTML and no run."""
