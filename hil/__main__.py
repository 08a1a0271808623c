"""``hil``, and ``python -m hil``: handle signals first, then import the command line."""

from __future__ import annotations

import gc
import os
import resource
import sys

TYPE_CHECKING = False  # the import of typing takes longer than all of this
if TYPE_CHECKING:
    from typing import Any


def main() -> Any:
    """Entry point of the console command ``hil``."""
    try:
        for stream in (sys.stdin, sys.stdout, sys.stderr):
            if stream is None:  # `>&-`: a log or a socket of ours would take its place, and what a plant prints go there
                os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8")
        if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
            # CPython keeps what it could write of a module's bytecode (ulimit -f), and no later import gets over it.
            sys.dont_write_bytecode = True
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        from hil.errors import heed_signals

        heed_signals()
        gc.disable()  # until `collect_garbage_again`: to look for garbage among modules takes a tenth of a short run
    except KeyboardInterrupt:
        os._exit(130)
    from hil.cli import guarded_main

    return guarded_main()


if __name__ == "__main__":
    sys.exit(main())
