"""The live page: a run that is watched in a browser, and in virtual time changed from there."""
