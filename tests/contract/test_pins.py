"""What is installed is what was tested: every package with its version and its hashes, the build and the installer too."""

import re
import tomllib
from importlib.metadata import distributions
from pathlib import Path

ROOT = Path(__file__).parents[2]


def pinned() -> dict[str, str]:
    """Requirement lines of `constraints.txt` by the name of the package, hashes included."""
    text = (ROOT / "constraints.txt").read_text().replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return {plain(re.split(r"[=;@ \[<>~!]", line)[0]): line for line in lines}


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_package_is_pinned_with_its_hashes() -> None:
    found = pinned()
    for name, line in found.items():
        assert re.match(r"[A-Za-z0-9._-]+==[0-9][^ ]*( |$)", line), line[:80]
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", line), name
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    assert {plain(re.split(r"[^A-Za-z0-9._-]", entry)[0]) for entry in asked} - {"hilrig"} <= set(found)
    assert set(found) & {plain(d.metadata["Name"]) for d in distributions()}


def test_build_and_installer_are_pinned() -> None:
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert build and all("==" in requirement for requirement in build)
    makefile = (ROOT / "Makefile").read_text()
    assert re.search(r"^UV = uv==[0-9.]+$", makefile, re.M) and "--verify-hashes" in makefile
