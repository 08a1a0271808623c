"""Chapter 7: output tracking over networks, send all, apply one."""
