"""Results in a notebook and in a paper: tables of pandas and xarray, figures of matplotlib, and the cells that show them.

``run`` has those of one run, ``result`` those of many runs, of a design and of a chapter, ``sheet`` what both draw with.
"""

from hil.notebook.result import Result, data_frame
from hil.notebook.run import cell, datasets, figure, tables
from hil.notebook.sheet import MM_PER_INCH, PAPER_STYLE

__all__ = ["MM_PER_INCH", "PAPER_STYLE", "Result", "cell", "data_frame", "datasets", "figure", "tables"]
