"""What a slot is made of: rig, controller node, safety. Nodes do no I/O and read no clock."""
