"""Names of the face, for type checkers and for `__init__.py`, which brings each one when it is first used."""

from hil.api.assertions import assert_law as assert_law
from hil.api.assertions import assert_probability as assert_probability
from hil.api.experiment_source import load_experiment as load_experiment
from hil.api.face import compare as compare
from hil.api.face import report as report
from hil.api.face import run as run
from hil.api.face import simulate as simulate
from hil.api.face import sweep as sweep
from hil.api.face import verify as verify
from hil.api.questions import DesignResult as DesignResult
from hil.api.questions import design as design
from hil.api.questions import laws as laws
from hil.errors import ExperimentError as ExperimentError
from hil.errors import HilError as HilError
from hil.experiment import Experiment as Experiment
from hil.log.read.run import read_run as read_run
from hil.log.run import Run as Run
from hil.session import Session as Session
from hil.sweeps import Sweep as Sweep
from hil.sweeps.comparison import Comparison as Comparison
from hil.sweeps.parameters import ParameterSweep as ParameterSweep
from hil.thesis import reproduce as reproduce
