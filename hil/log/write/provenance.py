"""What a log says about where it came from, so that it can be understood and run again without its author."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

FORMAT: Final = "1"
"""Version of the log's layout: attachments, metadata and topics."""

PACKAGES: Final = ("numpy", "scipy", "control", "cvxpy", "python-can", "eclipse-zenoh", "mcap", "zstandard", "msgspec")


def package_versions() -> dict[str, str]:
    """Versions of hilrig and of the packages that can change a result, read without importing them."""
    found = {}
    for name in ("hilrig", *PACKAGES):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Everything that stands in a log before its first record.

    Args:
        experiment: name of the experiment.
        experiment_text: the experiment file as the user wrote it (attachment ``experiment.toml``).
        resolved: the experiment after defaults and overrides (attachment ``resolved.json``).
        certificate: the design's certificate (attachment ``certificate.json``).
        seed: root of all random streams.
        clock: ``virtual`` or ``real``.
        link: URI of the link.
        versions: package name to version.
        codes: names behind the small integers of the records, for instance ``{"reason": REASONS}``.
        session: what only a session in real time may say: start, host, scheduler. Leave empty in virtual time, or two runs of one
            experiment are no longer the same file.
    """

    experiment: str
    experiment_text: str
    resolved: Mapping[str, Any]
    certificate: Mapping[str, Any] | None = None
    seed: int
    clock: str
    link: str
    versions: Mapping[str, str] = field(default_factory=package_versions)
    codes: Mapping[str, Sequence[str]] = field(default_factory=dict)
    session: Mapping[str, str] = field(default_factory=dict)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name, in the order of the file."""
        head = {"format": FORMAT, "experiment": self.experiment, "seed": str(self.seed), "clock": self.clock,
                "link": self.link}
        records = {
            "hilrig": head,
            "versions": dict(self.versions),
            "codes": {name: ",".join(names) for name, names in self.codes.items()},
            "session": {key: str(value) for key, value in self.session.items()},
        }
        return {name: dict(sorted(record.items())) for name, record in records.items() if record}
