"""The command line: a file for each command, or for a few that belong together, imported when one of them is called."""

from __future__ import annotations

import atexit
import errno
import io
import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

import click

from hil.cli.guard import Guard, signals_as_exceptions
from hil.errors import HilError, collect_garbage_again, exit_status, is_message, nearest, pass_over_signals, warn_in_one_line
from hil.plugins import WATCH, ProcessState, refuse_shadowed_packages

COMMANDS = {
    "run": ("run:run", "Run an experiment, log it, print its summary."),
    "list": ("list:command", "List experiments and plug-ins."),
    "show": ("list:show", "Print the file of a shipped experiment."),
    "new": ("new:new", "Write a plant, controller, law, measure or experiment of your own."),
    "check": ("new:check", "Check a plug-in, and say what it has earned."),
    "laws": ("laws:command", "Show the network laws of an experiment: stationary law, burst lengths."),
    "report": ("log_files:report", "Make a self-contained page from a log."),
    "live": ("run:live", "Watch a run in the browser, and change it there."),
    "replay": ("log_files:replay", "Verify a log, ask another controller, or put its frames on a bus."),
    "recover": ("log_files:recover", "Rebuild an indexed log from a torn one."),
    "export": ("log_files:export", "Write a log's frames or signals in other formats."),
    "layout": ("log_files:layout", "Make a layout of Foxglove, Lichtblick or PlotJuggler."),
    "can": ("can:can", "Bound the response times on a CAN bus; join such a bus and a vcan."),
    "dbc": ("can:dbc", "Print the DBC of the frames, make a C codec of it, decode a CAN log."),
    "sweep": ("sweep:command", "Run an experiment for many seeds on all cores."),
    "compare": ("compare:compare", "Compare experiments under common random numbers."),
    "rig": ("one_end:rig", "Run only the rig of an experiment, and wait for a controller on a link."),
    "controller": ("one_end:controller", "Run only the controller of an experiment, on a link."),
    "traffic": ("one_end:traffic", "Send the messages of a CAN bus's other nodes, as its DBC has them."),
    "design": ("design:command", "Solve a design and certify it."),
    "solve": ("list:solve", "Solve the gains of an experiment and store them beside it."),
    "identify": ("identify:command", "Estimate a plant, a network law or rates of faults from records."),
    "problems": ("compare:problems", "Show a set of problems, and run a controller against it."),
    "probe": ("bench:probe", "Measure a real link with our own frames, and log every round trip."),
    "stiffness-map": ("design:stiffness_map", "Map how stiff a virtual wall may be, certified."),
    "reproduce": ("reproduce:command", "Put the thesis's numbers beside computed ones."),
    "discover": ("one_end:discover", "Say which rigs and controllers are there on zenoh links."),
    "keys": ("one_end:keys", "Make keys and certificates for a link that lets one controller command."),
    "vcan": ("can:vcan", "Run a command where a real vcan0 exists."),
    "bench": ("bench:bench", "Measure timing, links and endurance on this machine."),
    "schema": ("list:schema", "Print the JSON Schema of experiment files."),
    "completion": ("completion:command", "Let the shell complete commands, experiments and keys."),
    "guide": ("guide:guide", "Print a page of the guide."),
    "licences": ("guide:licences", "List what is installed, and under which licence."),
    "doctor": ("doctor:command", "Check what this machine offers, with the remedy."),
}
"""Name of a command to the function that it is, in a file of this folder, and one line about it. A new command is a line here."""


PRINTING = ("check", "discover", "doctor", "guide", "licences", "list", "schema", "show")
"""Commands of which nothing is left but what they print."""


def command_of(name: str) -> click.Command:
    """Import the file of a command of `COMMANDS`, and return it."""
    file, function = COMMANDS[name][0].split(":")
    command: click.Command = getattr(import_module(f"hil.cli.{file}"), function)
    return command


def _close_stdout() -> None:
    """Let what is left in its buffer go nowhere, for where it went to takes no more."""
    with suppress(AttributeError, io.UnsupportedOperation):  # there is none, or none of the system's
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class LazyGroup(click.Group):
    """Knows the names and one line each; imports a command only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*COMMANDS]  # `list` is the file of that command here, once it was called

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        if cmd_name != "doctor":  # which reports it
            refuse_shadowed_packages()
            import_module("design.whole_process").begin_with_one_thread()
        command = command_of(cmd_name)
        if cmd_name != "run":  # whose own modules come when it is called
            collect_garbage_again()
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta[__name__] = tuple(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an interrupt is one line and status 130 or 143, not click's "Aborted!" and 1."""
        try:
            try:
                return super().invoke(ctx)
            finally:
                if sys.stdout is not None:  # `hil ... >&-`
                    sys.stdout.flush()  # here, where its faults can be reported
        except (KeyboardInterrupt, RuntimeError) as e:
            _end_if_interrupted(e)
            raise
        except click.exceptions.NoArgsIsHelpError:
            raise
        except click.UsageError as e:
            from hil.cli.option_types import expected, near_options, suggestion

            if isinstance(e, click.NoSuchOption):
                raise click.NoSuchOption(e.option_name, possibilities=near_options(e), ctx=e.ctx) from e
            raise click.UsageError((expected(e) or e.format_message()) + suggestion(e, ctx.meta[__name__]), e.ctx) from e
        except BrokenPipeError:  # `hil list | head`; click would make it a failure
            _close_stdout()
            sys.exit(141)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, about) for name, (_, about) in COMMANDS.items()])

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as e:
            if args and "Did you mean" not in e.message and (hint := nearest(args[0], COMMANDS, lead=" ")):
                raise click.UsageError(e.message + hint.replace("did", "Did", 1), ctx) from e
            raise


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="hilrig", prog_name="hil")
def cli() -> None:
    """Test a networked controller without the hardware: real processes, real links, an emulated network."""


def guarded_main() -> Any:
    """Run the command line of this process; a user's module that ends it in silence is reported, see `hil.cli.guard`."""
    atexit.register(pass_over_signals)  # the first, and so the last that runs
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error: a locale without a sign of ours ends no command
    warn_in_one_line()
    guard = Guard(ProcessState.now())
    WATCH.set(guard)
    status = 1
    try:
        main()
        status = 0
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
            end.code = 1
        status = end.code or 0
        raise
    finally:
        guard.end(status)


def _end_if_interrupted(error: BaseException) -> None:
    """End the process where an interrupt is what an error comes of.

    Python 3.11 makes a RuntimeError of one that comes while a class is made, pybind11 an ImportError while a library in C begins.
    """
    at: BaseException | None = error
    while at is not None and not isinstance(at, KeyboardInterrupt):
        at = at.__cause__
    if at is not None:
        print("\nhil: interrupted", file=sys.stderr)
        sys.exit(exit_status(at))


def main(args: list[str] | None = None) -> Any:
    """Run the command line; turn errors of the user into a message and status 2."""
    # Our matrices are small: a second BLAS thread costs time on a quiet machine and minutes on a busy one.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    words = sys.argv[1:] if args is None else args
    if sys.stdout is None:  # `hil ... >&-`
        ours = words[: words.index("--") if "--" in words else None]
        if prints := "--json" if "--json" in ours else next((word for word in ours[:1] if word in PRINTING), ""):
            print(f"hil: {prints} writes to standard output, which is closed; nothing was run", file=sys.stderr)
            sys.exit(2)
    if asked := os.environ.get("_HIL_COMPLETE"):
        from hil.cli.completion import completion_fault

        if fault := completion_fault(asked):
            print(f"hil: {fault}", file=sys.stderr)
            sys.exit(2)
    try:
        with signals_as_exceptions():
            plain = bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM") == "dumb"  # of bold, too
            return cli.main(args, prog_name="hil", standalone_mode=True, color=False if plain else None)
    except KeyboardInterrupt as e:  # between the last line of a command and the end of this process
        _end_if_interrupted(e)
    except OSError as e:
        status = 2
        if e.errno in (errno.EMFILE, errno.ENFILE):
            said = "no free file descriptor; raise the limit: ulimit -n 64"
        elif e.errno in (errno.ENAMETOOLONG, errno.ELOOP) and e.filename is not None:
            said = f"{str(e.filename)[:200]!r}: no path to a file: {e.strerror}"
        elif e.errno == errno.ENOENT and e.filename is None:  # of os.getcwd
            said = "the working folder is gone; change to one that is there"
        elif e.errno in (errno.ENOSPC, errno.EDQUOT):
            said = f"{e.filename or 'output'}: cannot be written: {e.strerror}"
        else:
            said, status = f"{e.filename or 'standard output or a file'}: {e.strerror or e}", 1
        if e.filename is None:
            _close_stdout()
        print(f"hil: {said}", file=sys.stderr)
        sys.exit(status)
    except MemoryError:
        print("hil: the machine has too little memory for this; the command and its files are correct", file=sys.stderr)
        sys.exit(1)
    except ImportError as e:  # where memory or the disk fails under a library; numpy puts a page of advice before the reason
        _end_if_interrupted(e)
        print(f"hil: a library cannot be loaded: {(str(e).strip() or repr(e)).splitlines()[-1]}", file=sys.stderr)
        sys.exit(1)
    except Exception as e:
        if not is_message(type(e)):
            raise
        from hil.cli.terminal import message_lines

        for line in message_lines(str(e)):
            print(f"hil: {line}", file=sys.stderr)
        sys.exit(e.status if isinstance(e, HilError) else HilError.status)


if __name__ == "__main__":
    main()
