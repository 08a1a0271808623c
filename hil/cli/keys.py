"""``hil keys``: keys and certificates that let one controller command, and no other."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hil.cli.option_types import Questions
from hil.cli.terminal import visible
from hil.errors import nearest


@click.group(cls=Questions)
def command() -> None:
    """Make keys and certificates for links that let only one controller command."""


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--host", "hosts", multiple=True, help="Name or address of the rig besides localhost; several allowed.")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificates are valid.")
def new(folder: Path, hosts: tuple[str, ...], days: int) -> None:
    """Make a test authority, certificates of rig and controller, and the key of the frames, in the new FOLDER."""
    from hil.files.keys import make_keys

    for path in make_keys(folder, hosts, days):
        print(visible(str(path)))
    print(f"zenoh:tls/127.0.0.1:7447?keys={visible(str(folder))}      certificates")
    print(f"can:hil:rig0?auth={visible(str(folder / 'frames.key'))}  a code in every frame, over any link")


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificates are valid.")
def renew(folder: Path, days: int) -> None:
    """Make new certificates for the keys in FOLDER, which `hil keys new` made; it must hold ca.key. No private key changes."""
    from hil.files.keys import renew_certificates

    for path in renew_certificates(folder, days):
        print(visible(str(path)))


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("name")
@click.option("--host", "hosts", multiple=True, help="Name or address of a rig of that name besides localhost; several allowed.")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificate is valid.")
def issue(folder: Path, name: str, hosts: tuple[str, ...], days: int) -> None:
    """Make a private key and a certificate called NAME in FOLDER, which `hil keys new` made; it must hold ca.key."""
    from hil.files.keys import issue_certificate

    for path in issue_certificate(folder, name, hosts, days):
        print(visible(str(path)))
    print(f"zenoh:tls/127.0.0.1:7447?keys={visible(str(folder))}&controller={name}   or &rig={name}, at both ends")


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
def revoke(folder: Path, names: tuple[str, ...]) -> None:
    """Let NAMES in no more: a list in FOLDER, which both ends need beside their ca.pem. Links that are open stay open."""
    from hil.files.keys import revoke_names

    print(visible(str(revoke_names(folder, names))))
    known = [path.stem for path in folder.glob("*.pem")]
    for name in (each for each in names if each not in known):
        said = f"{folder} holds no certificate of {name!r}, which is on the list now{nearest(name, known)}"
        print(f"hil: {visible(said)}", file=sys.stderr)


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
def signing(folder: Path) -> None:
    """Make a pair of keys that sign logs: FOLDER/signing.key is secret, FOLDER/signing.pub is for who checks them."""
    from hil.files.signature import make_signing_key

    key, public = (visible(str(path)) for path in make_signing_key(folder))
    print(f"hil run EXPERIMENT --sign {key}      signs the log: keep this file")
    print(f"hil replay LOG --verify --key {public}   checks it: give this file away")
