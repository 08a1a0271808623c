"""``hil probe``: measure a real link with our own frames, and log every round trip."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hil.cli.option_types import Duration
from hil.cli.terminal import Working
from hil.errors import HilError

MOST_FRAMES = 5_000_000


@click.command()
@click.argument("link", metavar="LINK")
@click.option("--seconds", "--for", "seconds", type=Duration(0.1, 86_400), default="30s", show_default=True, help="For how long.")
@click.option("--rate", type=click.FloatRange(0.1, 10_000), default=100.0, show_default=True, help="Frames per second.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write the log here [link.mcap].")
@click.option("--answer", "answers", is_flag=True, help="Be the other end: answer until Ctrl-C, and log nothing.")
@click.option("--both", is_flag=True, help="Be both ends, for a link within this machine.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def command(
    link: str, seconds: float, rate: float, output: Path | None, answers: bool, both: bool, force: bool
) -> None:  # fmt: skip
    """Measure LINK, such as zenoh:tcp/10.0.0.2:7447 or can:socketcan:can0, with our own frames, and write a log.

    At the other end runs `hil probe LINK --answer`. The log is for `hil identify law` and `hil design --network`.
    """
    from contextlib import nullcontext

    from hil.bench.probe import answer, answering, probe, write_probe_log
    from hil.files.outputs import check_output
    from transport.links.opening import open_link
    from transport.links.traits import traits_of
    from transport.links.zenoh_refusals import standard_output_is_free

    if answers and (both or output is not None):
        raise HilError("--answer: the other end measures nothing; expected no --both and no -o")
    if traits_of(link).one_process:
        raise HilError(f"link {link!r}: lies within one process; expected a link between two, such as can:hil:rig0")
    if answers:
        standard_output_is_free()
        with open_link(link, "controller") as end:
            print(f"hil: answering on {link}; Ctrl-C ends it", file=sys.stderr)
            answer(end)
    if rate * seconds > MOST_FRAMES:
        raise HilError(f"--seconds: {rate * seconds:.0f} frames, at most {MOST_FRAMES}; lower --rate")
    path = check_output(output or Path("link.mcap"), fresh=not force, remedy="choose another -o or add --force")
    standard_output_is_free()
    with answering(link) if both else nullcontext(), open_link(link, "rig") as end, Working(link) as watch:
        trips, one_clock = probe(end, rate, seconds, watch.counted)
    write_probe_log(path, link, rate, trips, one_clock)
    came = sorted((t.received_ns - t.sent_ns) / 1e6 for t in trips if t.received_ns)
    if came:
        middle = f"median round trip {came[len(came) // 2]:.4g} ms, longest {came[-1]:.4g} ms"
        clocks = "one clock" if one_clock else "two clocks"
        print(f"{path}: {len(came)} of {len(trips)} round trips came back; {middle}; {clocks}", file=sys.stderr)
    else:
        print(f"{path}: none of {len(trips)} round trips came back", file=sys.stderr)
