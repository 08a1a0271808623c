"""Fields of a table whose own table a plug-in fills, as its kind says: plant, controller, network law."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args

from hil.plugins import registry

if TYPE_CHECKING:
    from design.controllers import Controller
    from hil.plugins.user_plugins import Designer
    from plants.parts.protocols import Plant
    from transport.laws import NetworkLaw


class PlugIn(NamedTuple):
    """Marks such a field.

    Args:
        group: of the plug-in.
    """

    group: registry.Group


def plug_in_of(hint: Any) -> PlugIn | None:
    """Return the mark of a field's annotation, None where it has none."""
    return next((each for each in get_args(hint) if isinstance(each, PlugIn)), None)


if TYPE_CHECKING:
    PlantTable = Plant
    ControllerTable = Controller | Designer
    LawTable = NetworkLaw
else:  # what msgspec reads at run time
    PlantTable, ControllerTable, LawTable = (
        Annotated[Any, PlugIn(group)] for group in ("hil.plants", "hil.controllers", "hil.laws")
    )
