"""A measure of your own: a number of every run, and a figure on its page."""

from typing import ClassVar

import numpy as np


class Mine:
    """Energy of the input that was applied."""

    title: ClassVar = "Effort"
    note: ClassVar = "Energy of the input that was applied."
    topics: ClassVar = ("/actuator/applied",)  # what it reads of the log

    def quantities(self, signals):
        from hil.measure.measure import Quantity

        return (Quantity(name="effort", title="input energy", unit=f"{signals.input_unit()}² s", per_output=False),)

    def of(self, view):
        return {"effort": float(np.sum(view.applied() ** 2) * view.period_s)}

    def section(self, view):  # leave it out if you draw nothing
        from hil.pages import Figure, Section, Series

        effort = np.cumsum(view.applied()[:, 0] ** 2) * view.period_s
        series = Series(label="effort", x=np.arange(len(effort)) * view.period_s, y=effort)
        figure = Figure(title="Growth of the effort", series=(series,), y_unit=f"{view.signals.input_unit()}² s")
        return Section(title="Effort", place=15, blocks=(figure,))
