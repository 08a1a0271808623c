"""Chapter 3: H-infinity control under time-varying delays."""
