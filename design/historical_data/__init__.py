"""Chapter 5: control from the historical data of scheduled sensors.

A plant with several state delays is measured by sensor nodes that share a network. A node keeps a buffer and sends all of it
when its turn comes, so that the controller knows some of the past of every state: which part depends on the schedule.
"""
