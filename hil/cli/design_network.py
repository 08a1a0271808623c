"""A plant over a measured network: the one answer of `hil design` that loads scipy.stats, half a second of CPU."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.design_questions.design_problem import TrackingTarget
from hil.design_questions.measured_network import Measured, measured, over_network, region_verdict
from hil.errors import HilError
from hil.log.recordings.read import read_recording
from hil.log.recordings.recording import BACK, THERE, packet_records
from transport.law_fit.law_fit import fit_law

if TYPE_CHECKING:
    from design.tracking.synthesis import Design

DEADLINE = 0.6
"""Share of a slot within which a packet must come, as in an experiment that says nothing else."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OverMeasured:
    """A plant over a measured network.

    It is what ``hil design PLANT --network LOG`` designs for: what was measured of a link becomes the laws of the loop.

    Attributes:
        target: what is designed for.
        sc, ca: both directions.
        notes: what was done about clocks.
    """

    target: TrackingTarget
    sc: Measured
    ca: Measured
    notes: tuple[str, ...]

    def document(self, design: Design) -> dict[str, Any]:
        """Return the laws, and the verdict over all that the measurement leaves possible, as plain values."""
        region = region_verdict(self.target, design, self.sc, self.ca).to_json()
        return {THERE: _way(self.sc), BACK: _way(self.ca), "notes": list(self.notes), "region": region}


def _way(way: Measured) -> dict[str, Any]:
    fit = way.fit
    return {"class": fit.law_class, "packets": len(fit.record.sent_s), "law": fit.spec, "max_age": way.at.max_age}


def measured_network(path: Path, target: TrackingTarget) -> OverMeasured:
    """Read a log, fit both directions, and put the plant over them.

    Args:
        path: a log of `hil probe`, or of a run.
        target: plant and period; its network is replaced.

    Raises:
        HilError: the log has one direction, or a direction that no law explains.
    """
    records, notes = packet_records(read_recording([path]))
    if THERE not in records or BACK not in records:
        said = f"holds {' and '.join(records)}; a design needs both directions, as `hil probe` measures them"
        raise HilError(f"--network {path}: {said}")
    found = {}
    for way, record in records.items():
        try:
            found[way] = measured(fit_law(record, target.period_s, DEADLINE * target.period_s), holds_input=way == BACK)
        except HilError as error:
            raise HilError(f"--network {path}: {way}: {error}") from error
    return OverMeasured(target=over_network(target, found[THERE], found[BACK]), sc=found[THERE], ca=found[BACK], notes=notes)


def network_lines(said: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return what a document says of the measured network, line by line: name, value, remark."""
    lines = [(f"network, {way}", said[way]["class"], f"{said[way]['packets']} packets") for way in (THERE, BACK)]
    return [*lines, ("over all it leaves", said["region"]["state"], said["region"]["reason"])]
