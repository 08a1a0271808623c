"""Chapter 4: fault-tolerant control with random detection delays."""
