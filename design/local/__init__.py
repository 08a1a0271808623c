"""Designs for a plant without a network, by python-control: what a networked design is compared with."""
