"""A run: the order of a slot, the nodes that take part in it, virtual time, and real time in processes of their own."""
