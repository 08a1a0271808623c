"""Asked -> ready to run: the loop, its design, its certificate."""
