"""``hil live``: a page in the browser that shows a run while it goes on, and changes it."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import Within, foxglove_beside, foxglove_option
from hil.cli.terminal import Working, answer, json_option
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.experiment import Experiment


@click.command()
@click.argument("experiments", type=EXPERIMENT, nargs=-1, required=True, metavar="EXPERIMENT [EXPERIMENT] | LOG.mcap")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field, such as plant.gain=170.")
@click.option("--clock", type=click.Choice(["virtual", "real"]), default="virtual", show_default=True,
              help="real: as the link's processes keep time; takes fewer changes.")  # fmt: skip
@click.option("--link", metavar="URI", help="Link in real time.")
@click.option("--seed", type=int, help="Seed of the run; the experiment's own by default.")
@click.option("--duration", type=str, metavar="S", help="Length of the run: 10, 10s, 2min.")
@click.option("--speed", type=Within(1e-3, 1e3), default=1.0, show_default=True, help="Times real time.")
@click.option("--hold", "held", is_flag=True, help="Wait before slot 0, until the page says go.")
@click.option("--script", type=click.Path(path_type=Path), metavar="FILE",
              help="Without a page: run with the changes of a script, or of a log; in virtual time at full speed.")  # fmt: skip
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the page, on 127.0.0.1; any that is free by default.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE.mcap", help="Log; by default below runs/.")
@click.option("--force", is_flag=True, help="Replace the file of -o.")
@click.option("--folder", metavar="DIR", help="Of a LOG: where own modules stand: they are run.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@foxglove_option
@json_option("Print the summary as one JSON object, with --script.")
def command(
    experiments: tuple[str, ...], sets: tuple[str, ...], clock: str, link: str | None, seed: int | None, duration: str | None,
    speed: float, held: bool, script: Path | None, port: int, output: Path | None, force: bool, folder: str | None, show: bool,
    foxglove: int | None,
) -> None:  # fmt: skip
    """Watch a run of EXPERIMENT in the browser, and change it there: reference, disturbance, network, controller, faults.

    Each change is shown with the certificate of the loop that would run before it is applied, and is logged: `hil live --script
    LOG.mcap EXPERIMENT` runs it again without the page, `hil replay LOG.mcap` verifies it. Two experiments run side by side on
    the same random numbers. A LOG is shown as it was. The page is on loopback; its URL holds the token without which it only
    watches. Ctrl-C ends it.
    """
    from hil.cli.run import let_go, reserve
    from hil.cli.run_summary import show as show_summary
    from hil.experiment import load_experiment
    from hil.pages.live.watch import Asked, show_log, watch

    def opened(url: str) -> None:
        click.echo(f"open {url}", err=True)
        if show:
            click.launch(url)

    if experiments[0].endswith(".mcap"):
        from hil.log.read.run import read_run

        if len(experiments) > 1 or script is not None or foxglove is not None:
            remedy = "hil live EXPERIMENT --script LOG.mcap runs it again; Foxglove opens a log itself"
            raise HilError(f"a log is shown alone, and takes no script and no --foxglove; {remedy}")
        show_log(read_run(Path(experiments[0])), experiments[0], port=port, folder=folder, opened=opened)
        return
    if len(experiments) > 2:
        raise HilError(f"{len(experiments)} experiments; one, or two side by side, are shown")
    if len(experiments) == 2 and (clock == "real" or output is not None or script is not None or foxglove is not None):
        remedy = "in virtual time, with logs below runs/, and without --script, --foxglove or -o"
        raise HilError(f"two experiments run side by side {remedy}")
    if clock == "virtual" and link is not None:
        raise HilError("--link needs --clock real: virtual time runs in one process, without a link")

    def path(experiment: Experiment) -> Path:
        return reserve(output, f"{experiment.name}-live-seed{experiment.seed}", force)

    if script is not None:
        from hil.pages.live.script import Scripted, read_script
        from hil.session import run_session

        working = Working("changes, each with its certificate")
        scripted = Scripted(read_script(script), real=clock == "real", working=working)
        experiment = load_experiment(experiments[0], sets, seed=seed, duration=duration)
        with foxglove_beside(scripted, foxglove) as onlooker:
            session = run_session(experiment, clock=clock, link=link, path=path(experiment), onlooker=onlooker)  # type: ignore[arg-type]
        answer(session.summary, show_summary, session.summary)
        sys.exit(session.status)

    def load(name: str, again: int | None) -> Experiment:
        return load_experiment(name, sets, seed=seed if again is None else again, duration=duration)

    for name in experiments:  # what is wrong with them, or with where their logs go, is said before a page is there
        let_go(path(load(name, None)))
    asked = [
        Asked(load=partial(load, name), path=path, clock=clock, link=link, speed=speed, held=held)  # type: ignore[arg-type]
        for name in experiments
    ]
    with foxglove_beside(None, foxglove) as beside:
        status = watch(asked, port=port, opened=opened, finished=lambda session: show_summary(session.summary), beside=beside)
    sys.exit(status)
