"""What a log says about where it came from, so that it can be understood and run again without its author."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from platform import python_version
from typing import Any, Final, Literal

from msgspec import Struct, field

from hil.log import to_json
from hil.log.write import pipe_sink

LoopForm = Literal["compiled", "interpreted"]


def loop_form() -> LoopForm:
    """Return it: the modules that pyproject.toml names are compiled together or not at all, and this asks one of them."""
    return "interpreted" if str(pipe_sink.__file__).endswith(".py") else "compiled"


CHECKOUT: Final = Path(__file__).parents[3]
"""The folder of this package: the root of a checkout, or `site-packages`."""

FORMAT: Final = "3"
"""Version of the log's layout: attachments, metadata and topics."""

PACKAGES: Final = ("numpy", "scipy", "control", "cvxpy", "python-can", "eclipse-zenoh", "mcap", "zstandard", "msgspec")


@cache
def package_versions() -> dict[str, str]:
    """Versions of hilrig, of Python and of the packages that can change a result, read without importing them."""
    from transport.installed import versions_of  # `hil doctor` says, without it, that something stands in the place of transport

    found = dict.fromkeys(("hilrig", "python", *PACKAGES), "absent")
    return found | versions_of(("hilrig", *PACKAGES)) | {"python": python_version()}


_COMMIT = "# branch.oid "
_DIGITS = 12


@cache
def commit(checkout: Path = CHECKOUT) -> str:
    """Return the commit that runs, with ``-dirty`` where files differ from it; nothing outside a checkout or without git."""
    if not (checkout / ".git").exists():
        return ""
    import subprocess  # of a wheel there is no commit

    try:
        # Half the time of `git describe --dirty`, and the index is not written.
        answer = subprocess.run(
            ["git", "--no-optional-locks", "-c", "core.preloadIndex=false", "-C", str(checkout),
             "status", "--porcelain=v2", "--branch", "--untracked-files=no"],
            capture_output=True, text=True, timeout=10, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    lines = answer.stdout.splitlines()
    if answer.returncode or not lines or not lines[0].startswith(_COMMIT):
        return ""
    differs = any(not line.startswith("#") for line in lines)
    return lines[0][len(_COMMIT) :][:_DIGITS] + "-dirty" * differs


class Provenance(Struct, frozen=True, kw_only=True):
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
        loop: whether the loop ran compiled or interpreted; its records are the same.
        commit: of the checkout that runs; empty where there is none. The same for every run of one checkout.
        codes: names behind the small integers of the records, for instance ``{"reason": REASONS}``.
        channels: topic to what its channel says of itself in the file, such as the CAN identifiers of its frames.
        session: what only a session in real time may say: start, host, scheduler. Leave empty in virtual time, or two runs of one
            experiment are no longer the same file.
        origins: plant, controller and network laws, by their paths, that the experiment file alone does not make: what they are.
    """

    experiment: str
    experiment_text: str
    resolved: Mapping[str, Any]
    certificate: Mapping[str, Any] | None = None
    seed: int
    clock: str
    link: str
    versions: Mapping[str, str] = field(default_factory=package_versions)
    loop: LoopForm = field(default_factory=loop_form)
    commit: str = field(default_factory=commit)
    codes: Mapping[str, Sequence[str]] = field(default_factory=dict)
    channels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    session: Mapping[str, str] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name, in the order of the file."""
        head = {"format": FORMAT, "experiment": self.experiment, "seed": str(self.seed), "clock": self.clock,
                "link": self.link, "loop": self.loop} | dict(self.origins) | ({"commit": self.commit} if self.commit else {})
        records = {
            "hilrig": head,
            "versions": dict(self.versions),
            "codes": {name: ",".join(names) for name, names in self.codes.items()},
            "session": {key: str(value) for key, value in self.session.items()},
        }
        return {name: dict(sorted(record.items())) for name, record in records.items() if record}

    def attachments(self) -> list[tuple[str, str, bytes]]:
        """Attachments as (name, media type, bytes), in the order of the file."""
        found = [
            ("experiment.toml", "application/toml", self.experiment_text.encode("utf-8", "backslashreplace")),
            ("resolved.json", "application/json", to_json(self.resolved, indent=1)),
        ]
        if self.certificate is not None:
            found.append(("certificate.json", "application/json", to_json(self.certificate, indent=1)))
        return found
