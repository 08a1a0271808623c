"""Chapter 7: the networked DC motor and the VTOL; every number of Section 7.4 beside what a correct computation gives."""

from __future__ import annotations

from hil.reproduce.chapter import Chapter, Part, ReportProgress, Stage
from hil.reproduce.chapter7.designs import designs, gain_bounds, information
from hil.reproduce.chapter7.figures import motor_plots, smith, vtol_plots
from hil.reproduce.chapter7.friction import experiment_rows, fit
from hil.reproduce.chapter7.local import local_designs
from hil.reproduce.chapter7.models import model_rows, theorem_rows
from hil.reproduce.chapter7.tables import motor_table, vtol_table


def _models(report_progress: ReportProgress) -> Part:
    """The printed models, and statements of Section 7.3."""
    return Part(rows=(*model_rows(), *theorem_rows()))


def _experiment(report_progress: ReportProgress) -> Part:
    """The experiment column of Table 7.2 with a fitted motor, and Figures 7.6 to 7.8."""
    motor, misfit = fit(report_progress)
    rows = experiment_rows(motor, misfit, report_progress)
    return Part(rows=tuple(rows), figures=tuple(motor_plots(motor, report_progress)))


CHAPTER = Chapter(
    title="Chapter 7: robust tracking control of a networked DC motor",
    stages=(
        Stage("models and statements", _models, 1.5),
        Stage("designs", designs, 45),
        Stage("designs without the network", local_designs, 3),
        Stage("Table 7.1", vtol_table, 4),
        Stage("Figures 7.2 and 7.3", vtol_plots, 1),
        Stage("Table 7.2, simulation", motor_table, 10),
        Stage("Smith predictor", smith, 3),
        Stage("fit of the motor, Table 7.2, experiment", _experiment, 35),
        Stage("what the actuator knows", information, 25),
        Stage("gain bounds", gain_bounds, 10),
    ),
)
