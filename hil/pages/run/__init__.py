"""Pictures of a run; knows runs and no HTML."""
