"""``hil``, and ``python -m hil``: heed signals first, then import the command line."""

from __future__ import annotations

import os
import sys


def main() -> object:
    """Entry point of the console command ``hil``."""
    try:
        from hil.first_instants import heed_signals

        heed_signals()
    except KeyboardInterrupt:
        os._exit(130)
    from hil.cli import main

    return main()


if __name__ == "__main__":
    sys.exit(main())
