"""The JSON Schema of experiment files: the tables of :mod:`hil.experiment`, and one variant per installed plug-in."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final
from warnings import warn

import msgspec

from hil.errors import HilError
from hil.experiment.nodes import Node
from hil.experiment.rig_tables import Fault
from hil.experiment.table import Seconds
from hil.experiment.tables import HIDDEN, Direction, Experiment
from hil.plugins import registry
from hil.plugins.fields import described, meanings, parsed
from transport.durations import PATTERN

GROUPS: Final[tuple[registry.Group, ...]] = ("hil.plants", "hil.controllers", "hil.laws")
KEYS_OF_FAULT = dict(zip(Fault.__struct_fields__, Fault.__struct_encode_fields__))  # "for" is no name in Python


def _table(description: str, required: str, **properties: dict[str, str]) -> dict[str, Any]:
    return {"type": "object", "description": description, "properties": properties, "required": [required]}


TEXT: Final = {"type": "string"}
CLOSED: Final = {"additionalProperties": False}
OWN: Final = _table("module:Class of a Python file beside the experiment.", "kind", kind=TEXT | {"pattern": ":"})
LAW_FILE: Final = _table("A file of a network law, as `hil identify law` writes one, keys in place of its.", "file", file=TEXT)
ARRAY: Final = "The array of a file: .npz, .npy, .csv or .mat; key is its name in an .npz or .mat file."
FILE: Final = _table(ARRAY, "file", file=TEXT, key=TEXT) | CLOSED


def experiment_schema(
    plugins: Mapping[str, Mapping[str, type | None]] | None = None, warn: Callable[[str], object] = warn
) -> dict[str, Any]:
    """Return the schema as a JSON-able dict (draft 2020-12).

    Args:
        plugins: group ("hil.plants", "hil.controllers", "hil.laws") to name to class; what is installed by default.
        warn: called with a message on each installed plug-in that cannot be described; its table may have any keys.
    """
    if plugins is not None:
        return _schema(plugins)

    def installed(loaded: Callable[[registry.Group, str], type | None]) -> dict[str, dict[str, type | None]]:
        return {group: {name: loaded(group, name) for name in registry.names(group)} for group in GROUPS}

    try:
        return _schema(installed(registry.load))
    except Exception:  # of one of them: it is asked of each which
        return _schema(installed(partial(_describable, warn=warn)))


def _schema(plugins: Mapping[str, Mapping[str, type | None]]) -> dict[str, Any]:
    classes = {(group, name): cls for group, named in plugins.items() for name, cls in named.items() if cls is not None}
    found, definitions = msgspec.json.schema_components(
        [Experiment, Direction, Node, *classes.values()], schema_hook=_hook, ref_template="#/$defs/{name}"
    )
    experiment, direction, node, *tables = (definitions[ref["$ref"].rpartition("/")[2]] for ref in found)
    del definitions[found[0]["$ref"].rpartition("/")[2]]
    for definition in (experiment, *definitions.values()):
        if definition.get("type") == "object" and "properties" in definition:
            definition["additionalProperties"] = False  # an unknown key is a fault everywhere
            _explain(definition)
    for cls, table in zip(classes.values(), tables, strict=True):
        for field in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():
            if not field.init:  # nothing that a file could set
                del table["properties"][field.name]
    of = dict(zip(classes, tables, strict=True))

    def variants(group: str) -> dict[str, Any]:
        out = []
        for name in plugins[group]:
            own = dict(of.get((group, name), {"type": "object"}))
            fields = {key: _or_file(field) for key, field in own.get("properties", {}).items()}
            own["properties"] = {"kind": {"const": name}, **fields}
            own["required"] = ["kind", *own.get("required", [])]
            out.append(own)
        return {"oneOf": [*out, OWN]}

    for hidden in HIDDEN:
        del experiment["properties"][hidden]
    experiment["properties"]["plant"] |= variants("hil.plants")
    experiment["properties"]["controller"] |= variants("hil.controllers")
    laws = variants("hil.laws")
    laws["oneOf"].append(LAW_FILE | {"not": {"required": ["kind"]}})
    direction["properties"]["law"] |= laws
    direction["required"] = ["law"]
    node["properties"]["law"] |= laws
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "hilrig-experiment",
        **experiment,
        "$defs": definitions,
    }


def _describable(group: registry.Group, name: str, *, warn: Callable[[str], object]) -> type | None:
    """Return the class of a plug-in, None where it cannot be loaded, or has a key of a type that no file holds."""
    try:
        cls = registry.load(group, name)
        msgspec.json.schema_components([cls], schema_hook=_hook)
    except Exception as error:
        said = str(error).rpartition("\n")[2]
        why = said if isinstance(error, HilError) else f"{name!r} of the package {registry.provider(group, name)}: {said}"
        warn(f"{why}; the schema lets its table have any keys")
        return None
    return cls


def _or_file(field: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a field; of an array of numbers one that takes a file of them too."""
    inner = field
    while inner.get("type") == "array" and isinstance(inner.get("items"), dict):
        inner = inner["items"]
    if inner is field or inner.get("type") not in ("number", "integer"):
        return field
    kept = {key: field[key] for key in ("description", "default") if key in field}
    return kept | {"anyOf": [{key: value for key, value in field.items() if key not in kept}, FILE]}


def _explain(definition: dict[str, Any]) -> None:
    """Give every key what the docstring of its class says of it, so that an editor can show it."""
    doc = parsed(definition.get("description", ""))
    if doc is None:
        return
    definition["description"] = described(doc)
    for name, meaning in meanings(doc).items():
        key = name if name in definition["properties"] else KEYS_OF_FAULT.get(name, name)
        definition["properties"].get(key, {})["description"] = meaning


def _hook(kind: type) -> dict[str, Any]:
    if kind is Seconds:
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": PATTERN}]}
    raise NotImplementedError(kind)
