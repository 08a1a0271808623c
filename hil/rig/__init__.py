"""What an experiment says of its rig, derived: sensor nodes, media, CAN identifiers, delay chains, faults in time, port.

The loop that every process of a run receives, and what it is compared with.
"""
