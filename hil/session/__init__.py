"""One run, from an experiment to its log and its summary; and the replay of a log."""

from hil.session.both_clocks import Onlooker
from hil.session.finished import Session
from hil.session.run import ClockName, run_session, simulated_session

__all__ = ["ClockName", "Onlooker", "Session", "run_session", "simulated_session"]
