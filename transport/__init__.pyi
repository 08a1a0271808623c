"""Names of the face, for type checkers and for `__init__.py`, which brings each one when it is first used."""

from pathlib import Path

from transport.draws import REASONS as REASONS
from transport.draws import Draw as Draw
from transport.laws.age import ConstantAge as ConstantAge
from transport.laws.age import IidAge as IidAge
from transport.laws.age import MarkovAge as MarkovAge
from transport.laws.packet import GilbertElliott as GilbertElliott
from transport.laws.packet import PacketLaw as PacketLaw
from transport.laws.semi_markov import SemiMarkovAge as SemiMarkovAge
from transport.laws.trace import TraceAge as TraceAge
from transport.links import Link as Link
from transport.links import LinkCounters as LinkCounters
from transport.links import Role as Role
from transport.links import TransportError as TransportError
from transport.links.contract import check_link as check_link
from transport.links.memory import MemoryLink as MemoryLink
from transport.links.memory import memory_pair as memory_pair
from transport.links.opening import open_link as open_link
from transport.links.traits import CanFraming as CanFraming
from transport.links.traits import LinkTraits as LinkTraits
from transport.links.traits import SaysTraits as SaysTraits
from transport.medium.independent import Impairment as Impairment
from transport.medium.independent import impair as impair
from transport.packets import EMPTY as EMPTY
from transport.packets import MORE as MORE
from transport.packets import SELECTIONS as SELECTIONS
from transport.packets import ControlPacket as ControlPacket
from transport.packets import SensorPacket as SensorPacket
from transport.packets import decode as decode
from transport.packets import encode_control as encode_control
from transport.packets import encode_sensor as encode_sensor

def dbc_path() -> Path: ...
