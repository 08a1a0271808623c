"""The gallery of the guide: ``python -m tests.gallery FOLDER`` runs every shipped experiment and writes page and pictures there.

Each experiment has its first plot, its certificate, and the command that makes it. `make docs` puts the page beside the others.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hil
from hil.experiment import load_experiment, shipped
from hil.measure.view import view_of
from hil.pages import Figure, Scene, Section
from hil.pages.paper import write_figures
from hil.pages.sections import sections_of

COMMAND = "hil run {name}{also}"


def entries(pictures: Path) -> Iterator[str]:
    """Give the part of the page on each experiment, and write its picture.

    Args:
        pictures: folder of the pictures.
    """
    for name in shipped():
        try:
            session, also = hil.run(name), ""
        except hil.HilError:  # it is shown to be refused
            session, also = hil.run(name, allow_uncertified=True), " --set allow_uncertified=true"
        sections = view_of(session.run, session.experiment).once(sections_of)
        plot = next(block for section in sections for block in section.blocks if isinstance(block, Figure | Scene))
        with tempfile.TemporaryDirectory() as folder:
            (drawn, *_) = write_figures([Section(title=name, blocks=(plot,))], Path(folder), width_mm=120)
            (pictures / f"{name}.svg").write_bytes(drawn.read_bytes())
        said = load_experiment(name).description
        certificate = session.summary["certificate"] or {"state": "no certificate", "reason": "the experiment asks for none"}
        yield (
            f"## {name}\n\n{said}\n\n![{plot.title}](gallery/{name}.svg)\n\n"
            f"**{certificate['state']}**: {certificate['reason']}\n\n```console\n$ {COMMAND.format(name=name, also=also)}\n```\n"
        )


def main(folder: str) -> int:
    """Write gallery.md and the pictures into a folder."""
    pictures = Path(folder) / "gallery"
    pictures.mkdir(parents=True, exist_ok=True)
    head = "# Gallery\n\nEvery shipped experiment: its first plot, its certificate, and the command that makes it.\n\n"
    (Path(folder) / "gallery.md").write_text(head + "\n".join(entries(pictures)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
