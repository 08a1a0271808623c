"""Recorded packets, from our logs and from those of others: when each was sent, when it came, and what clocks did to that."""
