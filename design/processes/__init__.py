"""Random processes: rates, lifetimes, semi-Markov processes, delay chains."""
