"""What is asked: experiments, from a name or a TOML file to a checked, frozen description."""

from hil.experiment.load import (
    Experiment,
    experiment_from_resolved,
    load_experiment,
    parse_experiment,
    parse_plugin,
    set_field,
    shipped,
)
from hil.experiment.tables import Seconds

__all__ = [
    "Experiment", "Seconds", "experiment_from_resolved", "load_experiment", "parse_experiment", "parse_plugin", "set_field",
    "shipped",
]  # fmt: skip
