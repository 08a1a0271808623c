"""What plants are made of: exact propagation, friction, sensors, actuators, mode processes."""
