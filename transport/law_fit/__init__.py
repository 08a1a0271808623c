"""Network laws estimated from what was measured of packets: which class, which parameters, how sure, or none of these."""
