"""Ten loops of networked control: plant, network, objective and seeds, the best controller that is known, and a lower bound."""
