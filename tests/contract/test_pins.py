"""What is installed is what was tested: every package with its version and its hashes, the build and the installer too."""

import re
import tomllib
from importlib.metadata import distributions
from importlib.util import module_from_spec, spec_from_file_location
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


def hashed(path: Path) -> dict[str, str]:
    """Requirement lines of a list by the name of the package; each is one version with its hashes."""
    text = path.read_text().replace("\\\n", " ")
    found = {plain(re.split(r"[=;@ \[<>~!]", line)[0]): line for line in text.splitlines() if line.strip()}
    for name, line in found.items():
        assert re.match(r"[A-Za-z0-9._-]+==[0-9][^ ]*( |$)", line) and re.search(r"--hash=sha256:[0-9a-f]{64}\b", line), name
    return found


def test_build_and_installer_are_pinned_with_their_hashes() -> None:
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    lists = {name: hashed(ROOT / f".ci/{name}.txt") for name in ("build", "docs", "sbom")}
    assert {"pip", "uv", "hatchling", "editables", "pathspec", "pluggy", "trove-classifiers"} <= set(lists["build"])
    assert "sphinx" in lists["docs"] and "cyclonedx-bom" in lists["sbom"]
    known = pinned() | lists["build"]
    for requirement in build:
        version = requirement.partition(";")[0].strip()
        assert version in (ROOT / "constraints.txt").read_text() + (ROOT / ".ci/build.txt").read_text(), requirement
        assert plain(version.partition("==")[0]) in known


def test_what_compiles_the_loop_is_pinned_and_every_module_that_it_compiles_is_there() -> None:
    spec = spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None and spec.loader is not None
    hook = module_from_spec(spec)
    spec.loader.exec_module(hook)
    asked = hook.pinned(ROOT / "constraints.txt")
    assert {line.partition("==")[0] for line in asked} == set(hook.COMPILERS)
    assert all(pinned()[line.partition("==")[0]].startswith(f"{line} ") for line in asked)
    modules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["hooks"]["custom"]["compiled"]
    assert modules and all((ROOT / module).is_file() for module in modules)
    assert len(set(modules)) == len(modules)


def test_every_install_of_the_makefile_checks_hashes_and_fetches_nothing_else() -> None:
    makefile = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    asked = re.findall(r"-r [.\w/]+\.txt|-e \.\S*", makefile)
    assert len(asked) == 5, asked  # build, constraints, docs, sbom, and this folder
    for line in makefile.splitlines():
        for part in re.findall(r"[^&;]*(?:-r [.\w/]+\.txt|-e \.)[^&;]*", line):
            assert "--no-deps" in part and ("--require-hashes" in part or "--no-build-isolation -e ." in part), part
