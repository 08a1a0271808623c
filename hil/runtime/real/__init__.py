"""Real time: processes, their scheduling, their end."""
