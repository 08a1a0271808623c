"""What a log can be asked afterwards."""
