"""Chapter 2: robust state feedback of semi-Markov jump linear systems."""
