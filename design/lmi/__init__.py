"""Linear matrix inequalities: programs, solvers, proof in exact fractions."""
