"""``hil run``, ``hil live``: one experiment, its log, its summary; a page in the browser that shows a run and changes it."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import stat
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from design.whole_process import signals_later
from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import PATH, Duration, Within, foxglove_beside, foxglove_option
from hil.cli.terminal import Working, answer, json_option, visible, wants_json
from hil.errors import HilError, collect_garbage_again
from hil.files import check_ending

if TYPE_CHECKING:
    from hil.experiment import Experiment
    from hil.pages.live.server import LivePage
    from hil.session import Onlooker

"""What `hil rig` waits, s: until Ctrl-C."""

PRIVATE = 0o600  # a log says what a plant did: its user's alone, unless asked otherwise


def reserve(output: Path | None, stem: str, force: bool, mode: int = PRIVATE) -> Path:
    """Make the log's file, empty, so that no other run takes its name; by default the first free one below ``runs/``.

    Args:
        output: the file, or None.
        stem: of the name below ``runs/``.
        force: whether a file that is there may be overwritten.
        mode: who may read and write the file.

    Raises:
        HilError: if its name ends otherwise, it exists already (without ``force``) or cannot be created.
    """
    path = output or Path("runs") / f"{stem}.mcap"
    check_ending(path, "a log", ".mcap")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        number = 1
        while True:
            try:
                fresh = not (force and output is not None)
                flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK | (os.O_EXCL if fresh else os.O_NOFOLLOW)
                descriptor = os.open(path, flags, mode)
                try:
                    if stat.S_ISREG(os.fstat(descriptor).st_mode):  # a device is refused where the log is opened
                        os.fchmod(descriptor, mode)  # whatever the umask, and whoever could read the file before
                finally:
                    os.close(descriptor)
                return path
            except FileExistsError:
                if output is not None:
                    remedy = "choose another -o or add --force" if path.is_file() else "expected a new file: it is no regular one"
                    raise HilError(f"{path}: exists already; {remedy}") from None
                number += 1
                path = path.with_name(f"{stem}-{number}.mcap")
    except OSError as e:
        if e.errno == errno.ELOOP and path.is_symlink():
            real = os.path.realpath(path)
            message = f"{path}: is a symbolic link, and --force overwrites no file through one; name {real} itself"
            raise HilError(message) from None
        raise HilError(f"log {path}: cannot be created: {e.strerror}; -o names a file elsewhere") from e


def let_go(path: Path) -> None:
    """Remove a log that was reserved and holds nothing; one that another run writes has nothing yet, and stays."""
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            about = os.fstat(descriptor)
            if stat.S_ISREG(about.st_mode) and not about.st_size:  # a device has no bytes either, and stays
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
        finally:
            os.close(descriptor)


def session_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command what each takes that runs a session: changes, link, seed, duration and log."""
    for option in (
        click.option("--force", is_flag=True, help="Replace the file of -o."),
        click.option("-o", "--output", type=PATH, metavar="FILE.mcap", help="Log; by default below runs/."),
        click.option("--duration", type=str, metavar="S", help="Length of the run: 10, 10s, 2min."),
        click.option("--seed", type=int, help="Seed of the run; the experiment's own by default."),
        click.option("--link", metavar="URI", help="Link in real time, such as can:hil:rig0 or zenoh:tcp/127.0.0.1:7447; the "
                     "experiment's own by default."),
        click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE",
                     help="Change a field, such as plant.gain=170."),
    ):  # fmt: skip
        command = option(command)
    return command


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@session_options
@click.option("--clock", type=click.Choice(["virtual", "real"]), default="virtual", show_default=True,
              help="virtual: one process, as fast as it computes; real: rig and controller over a link.")  # fmt: skip
@click.option("--log-mode", "log_mode", metavar="OCTAL", default="600", show_default=True, help="Who may read the log.")
@click.option("--index", type=click.Choice(["full", "chunk"]), default="full", show_default=True,
              help="Index of the log; chunk: half the size, but Foxglove and Lichtblick refuse it.")  # fmt: skip
@click.option("--sign", "sign", type=PATH, metavar="KEY",
              help="Sign the log with this key (hil keys signing); the signature stands in FILE.mcap.sig.")  # fmt: skip
@click.option("--signals", metavar="URI", help="Publish named signals over zenoh, such as zenoh:tcp/127.0.0.1:7448.")
@click.option("--external", is_flag=True, help="Start no controller: your own program answers on the link (or: hil rig).")
@click.option("--wait", type=Duration(), help="How long to wait for it; 120 s by default.")
@click.option("--require-valid-timing", is_flag=True, help="Exit with 4 if the timing of the run is not valid.")
@json_option("Print the summary as one JSON object.")
@click.option("--quiet", is_flag=True, help="No live view.")
@foxglove_option
@click.option("--live", is_flag=True, help="Show the run on a page in the browser, too; virtual time is paced.")
def run(
    experiment: str, sets: tuple[str, ...], clock: str, link: str | None, seed: int | None, duration: str | None,
    output: Path | None, force: bool, log_mode: str, index: str, sign: Path | None, signals: str | None, external: bool,
    wait: float | None, require_valid_timing: bool, quiet: bool, live: bool, foxglove: int | None,
) -> None:  # fmt: skip
    """Run EXPERIMENT (a shipped name or a TOML file), log it to MCAP, print its summary.

    Exit status: 0 done; 1 the rig died or the log is not whole; 2 bad input, nothing started or written; 3 stopped by
    safety; 4 timing not valid (with --require-valid-timing); 5 a second controller answered too; 6 the link was flooded; 7 the
    plant or the controller was not what it says; 128 + N ended by signal N.
    """
    from hil.cli.page_text import print_summary
    from hil.experiment import load_experiment
    from hil.rig import rig_of
    from hil.rig.session_link import LONGEST_WAIT_S, link_of
    from hil.session import run_session
    from transport.links.traits import in_short

    collect_garbage_again()
    if not re.fullmatch("0?[0-7]{3}", log_mode) or (mode := int(log_mode, 8)) & 0o600 != 0o600:
        raise HilError(f"--log-mode: {log_mode!r:.20}; expected an octal mode with which you can read and write, such as 640")
    checked = load_experiment(experiment, sets, seed=seed, duration=duration)
    if clock == "virtual" and (link is not None or external):
        raise HilError("--link and --external need --clock real: virtual time runs in one process, without a link")
    if wait is not None and not external:
        raise HilError("--wait: only with --external; it is how long the rig waits for your program")
    if wait is not None and not 0.0 < wait <= LONGEST_WAIT_S:
        raise HilError(f"--wait: {wait:g}; expected more than 0 s and at most {LONGEST_WAIT_S:g} s")
    on = link_of(rig_of(checked), link, external=external) if clock == "real" else None
    uri = None if on is None else on.uri
    waits = ""
    if external and uri is not None:
        from hil.runtime.real.supervisor import EXTERNAL_TIMEOUT_S

        limit = "until Ctrl-C" if wait == LONGEST_WAIT_S else f"up to {wait or EXTERNAL_TIMEOUT_S:g} s"
        waits = f"waiting {limit} for your controller on {in_short(uri)}"
    signer = None
    if sign is not None:
        from hil.files.signature import Signer

        signer = Signer(sign)
    if signer is not None and output is not None and output.exists() and not output.is_file():
        raise HilError(f"--sign: {visible(output)} is no regular file: nothing can be signed there; name another file with -o")
    folder = output.parent if output else Path("runs")
    made = [each for each in (folder, *folder.parents) if not each.exists()]  # the innermost first
    path = None
    try:
        with signals_later():
            path = reserve(output, f"{checked.name}-{clock}-seed{checked.seed}", force, mode)
        with ExitStack() as views:
            onlooker: Onlooker | None = None
            if live:
                from hil.pages.live.watch import watched

                onlooker = views.enter_context(watched(clock, lambda page: click.echo(f"open {page.url}", err=True)))  # type: ignore[arg-type]
            if foxglove is not None:
                onlooker = views.enter_context(foxglove_beside(onlooker, foxglove))
            drawn = not (wants_json() or quiet) and sys.stderr is not None and sys.stderr.isatty()
            if drawn or waits:
                from hil.cli.live_view import LiveView
                from hil.pages.viewers import Beside

                view = views.enter_context(LiveView(checked, clock, link=uri, waits=waits, drawn=drawn))
                onlooker = view if onlooker is None else Beside(onlooker, view)
            session = run_session(
                checked, clock=clock, link=uri, path=path, external=external, wait_s=wait,  # type: ignore[arg-type]
                signals=signals, index=index, onlooker=onlooker,  # type: ignore[arg-type]
            )  # fmt: skip
    except BaseException:  # Ctrl-C too
        if path is not None:
            let_go(path)
        for each in made:
            with suppress(OSError):
                each.rmdir()  # unless there is something in it
        raise

    if signer is not None and path.is_file():
        signature = signer.sign(path, session.summary["log"]["sha256"], path.stat().st_size)
        session.summary["log"]["signature"] = str(signature)
    status = session.status
    if status == 0 and require_valid_timing and not session.summary["timing"]["valid"]:
        status = 4
    answer(session.summary, print_summary, session.summary)
    sys.exit(status)


@click.command()
@click.argument("experiments", type=EXPERIMENT, nargs=-1, required=True, metavar="EXPERIMENT [EXPERIMENT] | LOG.mcap")
@session_options
@click.option("--clock", type=click.Choice(["virtual", "real"]), default="virtual", show_default=True,
              help="real: separate processes keep time; takes fewer changes.")  # fmt: skip
@click.option("--speed", type=Within(1e-3, 1e3), default=1.0, show_default=True, help="Times real time.")
@click.option("--paused", is_flag=True, help="Pause before slot 0, until the page resumes.")
@click.option("--script", type=PATH, metavar="FILE",
              help="Without a page: run with the changes of a script, or of a log; in virtual time at full speed.")  # fmt: skip
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page on 127.0.0.1; a free one by default.")
@click.option("--folder", metavar="DIR", help="Of a LOG: folder of own modules, which are run.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@foxglove_option
@json_option("Print the summary as one JSON object, with --script.")
def live(
    experiments: tuple[str, ...], sets: tuple[str, ...], clock: str, link: str | None, seed: int | None, duration: str | None,
    speed: float, paused: bool, script: Path | None, port: int, output: Path | None, force: bool, folder: str | None, show: bool,
    foxglove: int | None,
) -> None:  # fmt: skip
    """Watch a run of EXPERIMENT in the browser, and change it there: reference, disturbance, network, controller, faults.

    A change of the loop is shown with the certificate that the loop would have before it is applied. Every change is logged:
    `hil live --script LOG.mcap EXPERIMENT` runs it again without the page, `hil replay LOG.mcap` verifies it. Two experiments
    run side by side on the same random numbers. A LOG is shown as it was. The page is on loopback; its URL holds the token
    without which it only watches. Ctrl-C ends it.
    """
    from hil.cli.page_text import print_summary
    from hil.experiment import load_experiment
    from hil.pages.live.watch import RequestedRun, show_log, watch

    def opened(page: LivePage) -> None:
        click.echo(f"open {page.url}", err=True)
        if show:
            click.launch(page.url_once())

    if experiments[0].endswith(".mcap"):
        from hil.log.read import read_run

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

    at_end = click.get_current_context().call_on_close

    def path(experiment: Experiment) -> Path:
        log = reserve(output, f"{experiment.name}-live-seed{experiment.seed}", force)
        at_end(partial(let_go, log))  # a run that is refused leaves nothing
        return log

    if script is not None:
        from hil.pages.live.script import Scripted, read_script
        from hil.session import run_session

        working = Working("changes, each with its certificate")
        scripted = Scripted(read_script(script), real=clock == "real", working=working)
        experiment = load_experiment(experiments[0], sets, seed=seed, duration=duration)
        with foxglove_beside(scripted, foxglove) as onlooker:
            session = run_session(experiment, clock=clock, link=link, path=path(experiment), onlooker=onlooker)  # type: ignore[arg-type]
        answer(session.summary, print_summary, session.summary)
        sys.exit(session.status)

    def load(name: str, again: int | None) -> Experiment:
        return load_experiment(name, sets, seed=seed if again is None else again, duration=duration)

    for name in experiments:  # what is wrong with them, or with where their logs go, is said before a page is there
        let_go(path(load(name, None)))
    asked = [
        RequestedRun(load=partial(load, name), path=path, clock=clock, link=link, speed=speed, paused=paused)  # type: ignore[arg-type]
        for name in experiments
    ]
    with foxglove_beside(None, foxglove) as beside:
        status = watch(asked, port=port, opened=opened, finished=lambda session: print_summary(session.summary), beside=beside)
    sys.exit(status)
