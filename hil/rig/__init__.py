"""What an experiment says of its rig, derived: sensor nodes, media, CAN identifiers, delay chains, faults in time, port."""
