"""Logs in MCAP: topics and their schemas, what is written while a run goes on, what is read afterwards."""
