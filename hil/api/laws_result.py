"""What the network laws of an experiment do in the long run, as a program and a notebook see it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hil.measure.measure import Named
from hil.notebook import Cell, Result, SingleResult, data_frame
from transport.law_tests.analysis import LawAnalysis

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

LONGEST = 20
"""Ages beyond which a plot does not go."""


class Laws(SingleResult, Named[LawAnalysis]):
    """The law of every way, by its name: ``sc`` or each sensor node, and ``ca``; drawn as how often the newest packet is how old.

    Args:
        experiment: its name.
        found: what each law does.
        period_s: length T of a slot, s.
    """

    def __init__(self, experiment: str, found: Mapping[str, LawAnalysis], period_s: float) -> None:
        super().__init__("way", dict(found))
        self.experiment, self.period_s = experiment, period_s

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row for every way and age: the share of slots in which the newest packet is that many slots old.

        Raises:
            HilError: if pandas is not installed.
        """
        rows = [(way, law.kind, age, share) for way, law in self.items() for age, share in enumerate(law.age_shares)]
        names = ("way", "law", "age", "share")
        columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
        return data_frame(columns, {"age": "slots", "share": "1"})

    def _paint(self, sheet: Figure) -> None:
        axis = sheet.subplots()
        width = 0.8 / len(self)
        for number, (way, law) in enumerate(self.items()):
            shares = law.age_shares[: LONGEST + 1]
            axis.bar(np.arange(len(shares)) + (number - (len(self) - 1) / 2) * width, shares, width, label=way)
        axis.set_xticks(range(min(max(len(law.age_shares) for law in self.values()), LONGEST + 1)))
        axis.set_xlabel("age of the newest packet (slots)")
        axis.set_ylabel("share of slots")
        axis.legend(frameon=False)

    def _result(self) -> Result:
        rows: list[list[Cell]] = [
            [way, law.kind, law.mean_age, 1e3 * law.mean_age * self.period_s, _known(law.mean_latency_s, 1e3),
             100 * law.loss_probability, _known(law.unused, 100)]
            for way, law in self.items()
        ]  # fmt: skip
        heads = ("way", "law", "mean age, slots", "mean age, ms", "mean latency, ms", "lost, %", "never used, %")
        return Result(line=repr(self)[1:-1], columns=heads, rows=rows, paint=self._paint)

    def __repr__(self) -> str:
        ways = ", ".join(f"{way} {law.kind} with mean age {law.mean_age:.3g} slots" for way, law in self.items())
        return f"<Laws of {self.experiment}: {ways}>"

    def __reduce__(self) -> tuple[type[Laws], tuple[str, dict[str, LawAnalysis], float]]:  # type: ignore[override]
        return Laws, (self.experiment, dict(self), self.period_s)


def _known(value: float, scale: float) -> float | None:
    return None if math.isnan(value) else scale * value
