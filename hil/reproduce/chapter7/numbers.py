"""Chapter 7: the networked DC motor and the VTOL; every number of Section 7.4 beside what a correct computation gives."""

from __future__ import annotations

from hil.reproduce import Progress, Reproduction


def reproduce(progress: Progress) -> Reproduction:
    """Models, norms, gains, Tables 7.1 and 7.2, Figures 7.2 to 7.4 and 7.6 to 7.8, and the fitted motor."""
    from hil.reproduce.chapter7.designs import design_rows, gain_bound_plot, information_plot
    from hil.reproduce.chapter7.figures import motor_plots, smith_plot, vtol_plots
    from hil.reproduce.chapter7.friction import experiment_rows, fit
    from hil.reproduce.chapter7.models import model_rows, theorem_rows
    from hil.reproduce.chapter7.tables import table_rows

    progress("models and statements")
    rows = [*model_rows(), *theorem_rows()]
    rows += design_rows(progress)
    information, claims = information_plot(progress)
    rows += claims
    progress("Tables 7.1 and 7.2")
    rows += table_rows()
    motor, misfit = fit(progress)
    rows += experiment_rows(motor, misfit, progress)
    smith, verdicts = smith_plot(progress)
    rows += verdicts
    bound = gain_bound_plot(progress)
    figures = (*vtol_plots(progress), smith, *motor_plots(motor, progress), information, bound)
    return Reproduction(
        title="Chapter 7: robust tracking control of a networked DC motor", rows=tuple(rows), figures=figures
    )
