"""Network laws: how old the newest packet is, or what happens to each packet."""
