"""The clock and the event kernel; no other file reads a clock or sleeps."""
