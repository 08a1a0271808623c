"""The attacks, each with the test files that try it: the rows of the table on the guide's page of faults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]

ATTACKS: Final[Mapping[str, tuple[str, ...]]] = {
    "bytes at all boundaries: files, frames, options": ("tests/hostile/test_boundaries.py",),
    "unexpected numbers in the shipped experiments": ("tests/hostile/test_numbers.py",),
    "hostile options and values": ("tests/hostile/test_options.py", "tests/hil/files/test_toml_text.py"),
    "floods of the link": ("tests/hostile/test_flood.py", "tests/hil/runtime/real/test_exchange.py"),
    "takeover by answers": ("tests/hostile/test_who_commands.py",),
    "takeover by questions": ("tests/hostile/test_forged_questions.py", "tests/hil/runtime/nodes/test_controller_node.py"),
    "forged and repeated tags (`auth=`)": ("tests/links/test_authentication.py",),
    "names, passwords, certificates (zenoh)": (
        "tests/links/test_zenoh_access.py", "tests/links/test_zenoh_claims.py", "tests/links/test_revoked_names.py",
    ),
    "sockets, channels and descriptors": (
        "tests/links/test_dead_channels.py", "tests/links/test_descriptors.py", "tests/transport/links/test_unix_mesh.py",
    ),
    "faults at random instants": ("tests/hostile/test_many_sessions.py",),
    "signals": ("tests/hostile/test_stop.py", "tests/hil/cli/test_run_ends.py", "tests/hil/runtime/real/test_child.py"),
    "processes killed or stopped": ("tests/realtime/test_sessions.py", "tests/hil/runtime/real/test_supervisor.py"),
    "full disk": ("tests/hil/session/test_full_disk.py",),
    "bombs: what unpacks to too much": ("tests/hil/log/read/test_mcap_walk.py", "tests/hil/files/test_mat_file.py"),
    "truncated, flipped and foreign logs": ("tests/hil/log/read/test_recover.py", "tests/hil/log/read/test_foreign.py"),
    "signatures of logs": ("tests/hil/files/test_signature.py",),
    "shadows in the working folder": ("tests/hostile/test_working_folder.py",),
    "completion by TAB": ("tests/hil/cli/test_completion.py",),
    "plug-ins and modules": ("tests/hil/plugins/test_user_modules.py", "tests/hostile/test_own_modules.py"),
    "FMUs": ("tests/plants/fmu/test_fmu_faults.py",),
    "output to a terminal": ("tests/hil/cli/test_terminal.py",),
    "symbolic links, pipes and devices": ("tests/hil/cli/test_outputs.py", "tests/hil/files/test_regular.py"),
    "guests of `hil vcan`": ("tests/vcan/test_hostile_guest.py", "tests/vcan/test_runner.py"),
}  # fmt: skip
"""Attack to the files whose tests are its tries."""


def attack_of(file: str) -> str:
    """Return the attack that a test file belongs to; a new file of tests/hostile is one of its own.

    >>> attack_of("tests/hostile/test_flood.py"), attack_of("tests/hostile/test_late_bytes.py")
    ('floods of the link', 'late bytes')
    """
    for attack, files in ATTACKS.items():
        if file in files:
            return attack
    return Path(file).stem.removeprefix("test_").replace("_", " ")


def files() -> list[str]:
    """Return all files of attacks, from the checkout's root."""
    new = (str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests/hostile").glob("test_*.py")))
    return [*dict.fromkeys([file for each in ATTACKS.values() for file in each] + [*new])]
