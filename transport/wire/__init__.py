"""The bytes of packets, one file per version. Use `transport.packets`."""
