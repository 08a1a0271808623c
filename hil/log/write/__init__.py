"""Writing a log: sinks, the pipe out of a process that keeps time, the MCAP file."""
