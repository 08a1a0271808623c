"""What a build needs of the machine: Debian's packages, installed only where that was asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from typing import Final

from hil.vcan.supervise import RunnerError, say

PROGRAMS: Final = {"xz-utils": "xz", "iproute2": "ip", "user-mode-linux": "linux.uml", "kmod": "kmod"}
"""Programs of a package that has another name."""


def need(packages: Sequence[str], *, install: bool) -> None:
    """Have Debian's packages, or raise with what to type.

    Args:
        packages: their names.
        install: install what is missing, as root.

    Raises:
        RunnerError: what is missing, and the command that helps.
    """
    missing = [package for package in packages if not _is_here(package)]
    if not missing:
        return
    names = " ".join(missing)
    how = f"apt-get update && apt-get install --no-install-recommends {names}"
    if not shutil.which("apt-get"):
        raise RunnerError(f"missing here: {names} (Debian's names; this is no Debian)")
    if os.geteuid() != 0:
        raise RunnerError(f"missing here: {names}. As root: {how}")
    if not install:
        raise RunnerError(f"missing here: {names}. Let them be installed with --install, or: {how}")
    say(f"installing {names}")
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environ = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for step in (["update"], ["install", "-y", "--no-install-recommends", *missing]):
        if subprocess.run(["apt-get", *step], env=environ, **quiet).returncode:  # type: ignore[call-overload]
            raise RunnerError(f"could not install {names} (offline?). Once there is a mirror: {how}")


def _is_here(package: str) -> bool:
    """Whether a package is installed; elsewhere than on Debian its program must do, and a library is left to the build."""
    if not shutil.which("dpkg-query"):
        return package.startswith("lib") or shutil.which(PROGRAMS.get(package, package)) is not None
    query = ["dpkg-query", "-W", "-f", "${Status}", package]
    return subprocess.run(query, capture_output=True, text=True).stdout.endswith(" installed")
