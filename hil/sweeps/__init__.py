"""Many runs of one experiment: seeds, records of what ran."""
