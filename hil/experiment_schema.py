"""The JSON Schema of experiment files: the tables of :mod:`hil.experiment`, and one variant per installed plug-in."""

from __future__ import annotations

from typing import Any

import msgspec

from hil import registry
from hil.experiment_tables import HIDDEN, UNITS, Direction, Experiment, Links, Seconds

PATTERN = rf"^\s*[-+0-9.eE]+( ({'|'.join(UNITS)}))?\s*$"


def experiment_schema() -> dict[str, Any]:
    """Return the schema as a JSON-able dict (draft 2020-12)."""
    kinds = {group: registry.names(group) for group in ("hil.plants", "hil.controllers", "hil.laws")}
    classes = {(group, name): registry.load(group, name) for group in kinds for name in kinds[group]}  # type: ignore[arg-type]
    _, definitions = msgspec.json.schema_components(
        [Experiment, *classes.values()], schema_hook=_hook, ref_template="#/$defs/{name}"
    )
    for definition in definitions.values():  # an unknown key is a fault everywhere
        if definition.get("type") == "object" and "properties" in definition:
            definition["additionalProperties"] = False

    def variants(group: str) -> dict[str, Any]:
        out = []
        for name in kinds[group]:
            cls = classes[group, name]
            own = dict(definitions[cls.__name__])
            own["properties"] = {"kind": {"const": name}, **own.get("properties", {})}
            own["required"] = ["kind", *own.get("required", [])]
            out.append(own)
        return {"oneOf": out}

    experiment = definitions["Experiment"]
    for hidden in HIDDEN:
        del experiment["properties"][hidden]
    experiment["properties"]["plant"] = variants("hil.plants")
    experiment["properties"]["controller"] = variants("hil.controllers")
    definitions[Direction.__name__]["properties"]["law"] = variants("hil.laws")
    definitions[Direction.__name__]["required"] = ["law"]
    definitions[Links.__name__]["properties"]["uri"]["description"] = "memory:, can:INTERFACE:CHANNEL, zenoh:ENDPOINT"
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "hilrig-experiment",
        **experiment,
        "$defs": definitions,
    }


def _hook(kind: type) -> dict[str, Any]:
    if kind is Seconds:
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": PATTERN}]}
    raise NotImplementedError(kind)
