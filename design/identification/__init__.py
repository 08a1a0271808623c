"""Plants from logs: the axis g / (s (s + p)) of device and motor, its start, its fit, its intervals, its residual test."""
