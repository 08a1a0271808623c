"""Chapter 5: J for every I(0), the bound of Theorem 5.1, its infeasibility, Figures 5.3 and 5.4."""
