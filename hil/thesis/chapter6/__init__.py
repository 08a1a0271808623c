"""Chapter 6: Lambda, Theorem 6.1, (6.10) to (6.17), Figures 6.8 and 6.10."""
