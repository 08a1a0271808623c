"""Worst-case response times of the messages on a CAN bus, and the load that they make."""
