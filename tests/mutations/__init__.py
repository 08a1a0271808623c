"""Faults in the product that tests must see: those that once survived, as patches (`make mutations`), and random ones."""
