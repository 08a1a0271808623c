"""Reading a log: arrays, recovery of what is torn, export."""
