"""``hil list``: experiments that come with the package, and every plug-in that is installed."""

from __future__ import annotations

import json

import click


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(as_json: bool) -> None:
    """List the shipped experiments and the installed plug-ins."""
    import tomllib

    from hil.experiment import plugins as registry
    from hil.experiment import shipped

    experiments = {
        name: tomllib.loads(path.read_text()).get("description", "") for name, path in shipped().items()
    }
    plugins = {
        group[4:]: {name: registry.provider(group, name) for name in registry.names(group)}
        for group in ("hil.plants", "hil.controllers", "hil.laws", "hil.links", "hil.measures")
    }
    if as_json:
        print(json.dumps({"experiments": experiments, "plugins": plugins}, indent=2))
        return
    width = max(map(len, experiments), default=0)
    print("experiments")
    for name, description in experiments.items():
        print(f"  {name:<{width}}  {description}")
    for group, found in plugins.items():
        ours = [name for name, dist in found.items() if dist == "hilrig"]
        theirs = [f"{name} (from {dist})" for name, dist in found.items() if dist != "hilrig"]
        print(f"{group}\n  {', '.join(ours + theirs)}")
