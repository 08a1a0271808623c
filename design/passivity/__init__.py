"""Chapter 6: a hand, a device, a delayed link, a coupler and a wall; what is passive, what is stable, how stiff it can be."""
