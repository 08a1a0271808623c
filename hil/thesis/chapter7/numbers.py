"""Chapter 7: the networked DC motor and the VTOL; every number of Section 7.4 beside what a correct computation gives."""

from __future__ import annotations

from typing import Any

from hil.thesis.chapter import Chapter, ReportProgress, Stage
from hil.thesis.chapter7.designs import DESIGNS, INFORMED, designs, gain_bounds, information
from hil.thesis.chapter7.estimate import ESTIMATED, estimated_delay
from hil.thesis.chapter7.figures import SMITH, motor_plots, smith, vtol_plots
from hil.thesis.chapter7.friction import EXPERIMENT_ROWS, experiment, fit
from hil.thesis.chapter7.further import INTEGRAL, STAYS, TRADE_OFF, UNCERTAIN, integral_action, stays, trade_off, uncertain
from hil.thesis.chapter7.models import LOCAL_DESIGNS, MODELS, local_designs, models
from hil.thesis.chapter7.tables import TABLE_7_1_ROWS, TABLE_7_2_ROWS, motor_table, vtol_table


def _experiment(report_progress: ReportProgress) -> dict[str, Any]:
    """The experiment column of Table 7.2 with a fitted motor, and Figures 7.6 to 7.8."""
    motor, misfit = fit(report_progress)
    return experiment(motor, misfit, report_progress) | {"figures": motor_plots(motor, report_progress)}


CHAPTER = Chapter(
    title="Chapter 7: robust tracking control of a networked DC motor",
    stages=(
        Stage("models and statements", models, 1.5, MODELS),
        Stage("designs", designs, 45, DESIGNS),
        Stage("designs without the network", local_designs, 3, LOCAL_DESIGNS),
        Stage("Table 7.1", vtol_table, 8, TABLE_7_1_ROWS),
        Stage("Figures 7.2 and 7.3", vtol_plots, 1),
        Stage("Table 7.2, simulation", motor_table, 10, TABLE_7_2_ROWS),
        Stage("Smith predictor", smith, 3, SMITH),
        Stage("fit of the motor, Table 7.2, experiment", _experiment, 35, EXPERIMENT_ROWS),
        Stage("what the actuator knows", information, 25, INFORMED),
        Stage("an estimate of d", estimated_delay, 7, ESTIMATED),
        Stage("gain bounds", gain_bounds, 10),
        Stage("trade-off of the norms, lost packets", trade_off, 5, TRADE_OFF),
        Stage("uncertain plants", uncertain, 9, UNCERTAIN),
        Stage("integral action", integral_action, 2, INTEGRAL),
        Stage("the stay of d", stays, 0.5, STAYS),
    ),
)
