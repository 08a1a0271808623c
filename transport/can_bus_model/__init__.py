"""A CAN (FD) bus that takes time: the bits of a frame, who wins the bus, what an error costs, and who is still on it."""
