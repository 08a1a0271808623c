"""What an experiment says of its rig, derived: sensor nodes, media, CAN identifiers, delay chains, faults in time, port.

A run's processes receive it with the loop, and with what the loop is compared with while it runs.
"""
