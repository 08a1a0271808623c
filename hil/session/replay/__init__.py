"""The replay of a log: verify it, run another controller on it, put it on a link."""
