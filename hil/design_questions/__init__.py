"""What `hil design` asks beside a run: problems in the user's words, bounds, uncertain plants, a coupler in C."""
