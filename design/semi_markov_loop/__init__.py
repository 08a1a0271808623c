"""Chapters 2 to 4: continuous-time semi-Markov jump loops, gains scheduled by mode and sojourn time."""
