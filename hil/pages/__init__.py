"""Pages and figures: runs, comparisons and sweeps as self-contained HTML and for paper; and the live page of a run.

What a section of a page is made of, for measures that draw (see `hil.pages.sections.DrawsSection`):

>>> from hil.pages import Section, Text
>>> Section(title="Mine", blocks=(Text(text="what I saw"),)).place
100
"""

from hil.pages.html.figures import Badge as Badge
from hil.pages.html.figures import Band as Band
from hil.pages.html.figures import BarGroup as BarGroup
from hil.pages.html.figures import Bars as Bars
from hil.pages.html.figures import Figure as Figure
from hil.pages.html.figures import Histogram as Histogram
from hil.pages.html.figures import Marker as Marker
from hil.pages.html.figures import Matrix as Matrix
from hil.pages.html.figures import Scene as Scene
from hil.pages.html.figures import Section as Section
from hil.pages.html.figures import Series as Series
from hil.pages.html.figures import Shape as Shape
from hil.pages.html.figures import Table as Table
from hil.pages.html.figures import Text as Text
