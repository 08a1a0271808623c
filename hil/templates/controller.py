"""A controller of your own. Its fields are the keys of the table [controller] of an experiment."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Mine:
    """u = gain (y - r), on the newest sample that has come, whatever its age.

    Args:
        gain: input per unit of the error.
    """

    gain: float = -0.1
    selection: ClassVar = "constant"  # one row of inputs for every delay d to the actuator

    def table(self, model):  # (tau, rows, inputs, outputs): with it the loop can be certified
        return np.full((model.tau_max + 1, 1, 1, 1), self.gain)

    def start(self, model):
        return self

    def rows(self, k, tau, y, r):  # slot k, age tau of the sample, y = y(k - tau), reference r
        return ((self.gain * (y[0] - r[0]),),)
