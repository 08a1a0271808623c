"""``hil dbc``: the frames of the link for other tools: the DBC, a C codec made of it, recorded frames decoded by it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.terminal import visible
from hil.errors import HilError

NAME = "hilrig"


@click.command()
@click.argument("experiment", type=EXPERIMENT, required=False)
@click.option("--link", metavar="URI", help="Framing and base of another link than EXPERIMENT's own.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field of EXPERIMENT.")
@click.option("--c", "folder", type=click.Path(path_type=Path), metavar="DIR", help="Write a C codec here: hilrig.h, hilrig.c.")
@click.option("--decode", "log", type=click.Path(path_type=Path), metavar="FILE", help="Decode a CAN log, .log or .blf.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def command(
    experiment: str | None, link: str | None, sets: tuple[str, ...], folder: Path | None, log: Path | None, force: bool
) -> None:
    """Print the DBC of the link's frames; of EXPERIMENT with a message for each sensor node, and each value by its name.

    With --c write a C codec that cantools makes of it, for a controller on another machine; with --decode print what the
    frames of a CAN log say, one JSON object a line.
    """
    if experiment is None and (link is not None or sets):
        raise HilError("--link and --set: name an experiment; without one the DBC is that of any one node below 0x100")
    if folder is not None and log is not None:
        raise HilError("--c and --decode: one at a time")
    text = _text(experiment, link, sets)
    if folder is not None:
        _write_codec(_database(text), folder, force)
    elif log is not None:
        _decode(_database(text), log)
    else:
        print(text, end="")


def _text(experiment: str | None, link: str | None, sets: tuple[str, ...]) -> str:
    from hil.experiment import load_experiment
    from hil.rig.normal_form import rig_of
    from hil.rig.session_link import rig_dbc
    from transport import dbc_path
    from transport.links.link import TransportError

    if experiment is None:
        return dbc_path().read_text(encoding="utf-8")
    try:
        return rig_dbc(rig_of(load_experiment(experiment, sets)), link)
    except (TransportError, ValueError) as error:
        raise HilError(f"{experiment}: {error}") from error


def _write_codec(database: Any, folder: Path, force: bool) -> None:
    from cantools.database.can.c_source import generate

    from hil.files.outputs import check_output, made_folder, write_output

    header, source = (made_folder(folder) / f"{NAME}.{ending}" for ending in ("h", "c"))
    for path in (header, source):
        check_output(path, fresh=not force, remedy="choose another --c or add --force")
    texts = generate(database, NAME, header.name, source.name, "")
    for path, text in zip((header, source), texts):
        write_output(path, text, replace=force)
        print(visible(path))


def _decode(database: Any, log: Path) -> None:
    from cantools.database import DecodeError

    from hil.files.can_logs import can_frames

    for frame in can_frames(log):
        try:
            message = database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            continue  # another node's
        try:
            signals = message.decode(bytes(frame.data), decode_choices=True, allow_truncated=True)
        except (DecodeError, ValueError) as e:
            raise HilError(f"{log}: a frame {frame.arbitration_id:#x} is none of {message.name}: {e}") from e
        values = {name: value if isinstance(value, int | float) else str(value) for name, value in signals.items()}
        print(json.dumps({"t_s": round(frame.timestamp, 9), "frame": message.name, **values}))


def _database(text: str) -> Any:
    import cantools

    return cantools.database.load_string(text, "dbc")
