"""From logs: the axis g / (s (s + p)) of device and motor, its fit, intervals, residual test; rates of faults and detection."""
