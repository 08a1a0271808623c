"""The rig: a plant, its sensor nodes and its actuator node, and the emulated network on both sides of them.

Nothing here does I/O or reads a clock: :meth:`Rig.sense` returns the frames that leave, :meth:`Rig.on_frame` takes those that
come, records go to a sink, and time is the nominal time that the kernel hands over. The order of a slot stands in
:mod:`hil.runtime.slot`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

from hil.log import DEPARTED, WITHDRAWN
from hil.log.records import Channel
from hil.log.write import Sink
from hil.rig.can_bus import can_bus_of
from hil.rig.loop import EQUAL, JumpStep, Loop, OneStep
from hil.rig.sensors import SharedMedium
from hil.runtime.nodes import Wire, rng_for
from hil.runtime.nodes.actuator_node import ActuatorNode
from hil.runtime.nodes.answer_matcher import AnswerMatcher
from hil.runtime.nodes.journal import Journal
from hil.runtime.nodes.network import FaultInjector, clock_of, impaired, sensor_medium_of
from hil.runtime.nodes.plant_watch import PlantWatch
from hil.runtime.nodes.safety import Safety, damper_of
from hil.runtime.nodes.sensor_node import SensorNode, trigger_of
from plants.parts.protocols import GoesOn, Plant, PlantRun
from transport.links.can_identifiers import Identifiers
from transport.medium import ChangingMedium, Delivery, IndependentChannels, OneWay
from transport.packets import EMPTY, MORE, SensorPacket, encode_sensor

if TYPE_CHECKING:
    from hil.runtime.nodes.can_network import CanNetwork
    from hil.runtime.nodes.jump_watch import JumpWatch, LawWatch
    from transport.can_bus_model.bus import Transmission
    from transport.can_bus_model.node import CanNode

STATES = {"active": "error active", "warning": "above the warning level", "passive": "error passive", "off": "off the bus"}

_new: Final = tuple.__new__  # without the Python constructor: in five files 6 % of an interpreted virtual slot


class Rig:
    """Plant, nodes and media of one loop.

    Args:
        loop: the composed experiment.
        seed: seed of the run.
        sink: where records go.
        channels: the table of what is logged.
        stop: ends the run (after a trip of the safety, once ``after_trip`` has passed).
        wire: the nonces; by default none, as no other process can send in virtual time.
        identifiers: CAN identifiers of the frames, where the table holds them.
        woken: when the slot of a nominal time really began, session time, ns; in virtual time at its nominal time.
        changing: whether the experiment may be changed in the run, see `change`.
    """

    def __init__(
        self,
        loop: Loop,
        seed: int,
        sink: Sink,
        channels: dict[str, Channel],
        stop: Callable[[], None],
        wire: Wire | None = None,
        identifiers: Identifiers | None = None,
        woken: Callable[[int], int] | None = None,
        changing: bool = False,
    ) -> None:
        e = loop.experiment
        self._seed = seed
        inputs, names = len(e.plant.inputs), [s.name for s in e.plant.states]
        self._period_ns, self._woken = e.period_ns, woken
        self._plant, self._moved = e.plant.start(rng_for(seed, "plant")), False  # whether it is in the next slot already
        self._samples = [sensor.buffer for sensor in loop.rig.sensors]
        self._sensors = tuple(SensorNode(s.outputs, s.buffer, trigger_of(s.trigger), clock_of(s, seed)) for s in loop.rig.sensors)
        faults = FaultInjector(loop, seed, changing)
        self._faults = faults if faults.there else None
        shared = can_bus_of(loop.rig)
        bus = self._bus = None if shared is None else self._bus_of(loop, shared, seed)
        medium, channel = sensor_medium_of(loop, seed, bus), impaired(loop, loop.rig.ca_law, seed, "link.ca")
        self._network: tuple[ChangingMedium, ChangingMedium] | None = None
        if changing:
            back = ChangingMedium(IndependentChannels([channel]), 1, loop.model.d_max + 1)
            self._network = ChangingMedium(medium, len(self._sensors), loop.model.tau_max + 1), back
            medium, channel = self._network[0], OneWay(back)
        self._to_controller = faults.to_controller(medium)
        self._to_actuator = faults.to_actuator(channel if bus is None else bus.to_actuator(channel))
        limits = [(names.index(name), e.plant.states[names.index(name)], bound) for name, bound in e.limits.state.items()]
        safety = Safety(e.limits.input, limits, e.limits.watchdog_slots, e.period_ns, e.plant.inputs)
        self._port = loop.rig.port.output if loop.rig.port is not None and e.limits.passivity is not None else None
        self.actuator = ActuatorNode(inputs, loop.model.d_max, safety, damper_of(loop), loop.rig.row_sojourns)
        numbers = [(i,) if sensor.numbered else () for i, sensor in enumerate(loop.rig.sensors)]
        self._journal = Journal(sink, channels, loop.rows * inputs, numbers, identifiers)
        self._nonce = None if wire is None else wire.nonce
        self._counter = 0
        self.answers = AnswerMatcher(inputs, loop.model.d_max, self._journal, e.period_ns, loop.rig.row_sojourns)
        self._reference, self._disturbance, self._disturbed = loop.reference(), loop.disturbance(), bool(e.disturbance)
        self._after_trip = round(e.limits.after_trip / e.period)
        self._end: int | None = None
        self._stop = stop
        self.k = -1
        self._slots = 0  # that were completed
        self._x: Sequence[float] = self._plant.state
        self._y: tuple[float, ...] = ()
        self._r: tuple[float, ...] = ()
        self._w: tuple[float, ...] = (0.0,) * inputs
        self._sent: Sequence[Delivery] = ()
        self._claimed = loop.watched is not None and loop.watched.claimed
        self._put_out: tuple[int, str] | None = None  # the first slot in which the plant said so of another input
        self._laws: list[tuple[int, LawWatch]] = []
        if loop.watched is not None and loop.watched.laws:
            from hil.runtime.nodes.jump_watch import LawWatch

            self._laws = [(i, LawWatch(loop.rig.laws[i])) for i in loop.watched.laws]
        self._past_laws: list[LawWatch] = []
        self._past_watch: PlantWatch | JumpWatch | None = None
        self._watch = None if loop.watched is None else self._watch_of(loop.watched.plant, e.plant, seed)

    def _watch_of(self, step: OneStep | JumpStep | None, plant: Plant, seed: int) -> PlantWatch | JumpWatch | None:
        def start(again: int = 0) -> PlantRun:
            return plant.start(rng_for(seed, "plant, again" if again else "plant"))

        if step is None:
            return None
        if isinstance(step, JumpStep):
            from hil.runtime.nodes.jump_watch import JumpWatch

            return JumpWatch(step, start, self._period_ns)
        return PlantWatch(step, start, self._disturbed_by, self._period_ns)

    def _disturbed_by(self, k: int) -> tuple[float, ...]:
        """Return the disturbance of a slot as the run has it in the end: a change adds to it, and takes nothing back."""
        return self._disturbance.at(k)

    def change(self, loop: Loop, *, network: Literal["sc", "ca"] | None = None, plant: bool = False) -> None:
        """Go on, before the next slot, with a changed experiment of the same signals, nodes and limits.

        Args:
            loop: the composed experiment.
            network: the direction whose network law is another one; the other direction draws on.
            plant: whether the plant's parameters are others; what it did until now is compared with its model, and no more.
        """
        e = loop.experiment
        self._reference, self._disturbance, self._disturbed = loop.reference(), loop.disturbance(), bool(e.disturbance)
        self._claimed = self._claimed or (loop.watched is not None and loop.watched.claimed)
        if self._faults is not None:
            self._faults.change(loop)
        if self._bus is not None:
            self._bus.plan(e)
        if plant and isinstance(e.plant, GoesOn):
            if self.k >= 0 and not self._moved:  # until the next slot the plant before moves
                self._plant.advance(self._period_ns, self.actuator.u, self._w)
                self._moved = True
            self._plant = e.plant.go_on(self._plant)
            self._past_watch = self._past_watch or self._watch
            self._watch = None
        if network is not None and self._network is not None:
            self._change_network(loop, network)

    def _change_network(self, loop: Loop, direction: Literal["sc", "ca"]) -> None:
        """Let another law take over, which begins as many slots ago as its longest delay has."""
        medium, channel = self._network  # type: ignore[misc]
        k, back = self.k + 1, direction == "ca"
        first = max(k - 1 - (loop.model.d_max if back else loop.model.tau_max), 0)
        if back:
            channel.change(IndependentChannels([impaired(loop, loop.rig.ca_law, self._seed, "link.ca", first)]), k, first)
        else:
            medium.change(sensor_medium_of(loop, self._seed, first=first), k, first)
        own = [law for law in self._laws if (law[0] == len(self._sensors)) == back]
        self._past_laws += [law for _, law in own]
        self._laws = [law for law in self._laws if law not in own]  # one that takes over does not begin as its chain does

    def sense(self, t_ns: int) -> list[bytes]:
        """Advance the plant to t_k, measure, and return the frames of what the medium lets arrive in this slot."""
        k = self.k = t_ns // self._period_ns
        if self._moved:
            self._moved = False
        elif k:
            self._plant.advance(self._period_ns, self.actuator.u, self._w)
        y = self._y = tuple(self._plant.measure())
        self._r = self._reference.at(k)
        nonce = self._nonce(k) if self._nonce is not None else 0
        for i, node in enumerate(self._sensors):
            sample = node.measure(k, y, self._to_controller.may_send(i, k))
            if sample is not None:
                self._to_controller.offer(i, k, sample)
        self._sent = self._to_controller.collect(k)
        mangled: list[bytes] = []
        if self._faults is not None:
            mangled = [self._faults.flip(self._frame(k, nonce, MORE, *arrived)) for arrived in self._faults.mangled()]
        frames = self._frames(k, nonce)
        self.answers.open(t_ns, k, frames if nonce else ())
        return mangled + frames if mangled else frames

    def _frame(self, k: int, nonce: int, flags: int, node: int, g: int, y: tuple[float, ...]) -> bytes:
        self._counter += 1
        return encode_sensor(
            SensorPacket(
                k, flags, g * self._period_ns, y, node, self._samples[node], self._r, len(self._sensors), nonce, self._counter
            )
        )

    def _frames(self, k: int, nonce: int) -> list[bytes]:
        sent, reference = self._sent, self._r
        if len(sent) == 1 == len(sent[0][1]):  # the usual case, at once: 8 % of an interpreted virtual slot
            g, y = sent[0][1][0]
            self._counter += 1
            usual = (k, 0, g * self._period_ns, y, 0, self._samples[0], reference, 1, nonce, self._counter)
            return [encode_sensor(_new(SensorPacket, usual))]
        nodes = len(self._sensors)
        arrivals = [(node, g, y) for node, (_, arrived) in enumerate(self._sent) for g, y in arrived]
        if not arrivals:
            self._counter += 1
            nothing = SensorPacket(k, EMPTY, 0, (), reference=reference, nodes=nodes, nonce=nonce, counter=self._counter)
            return [encode_sensor(nothing)]
        last = len(arrivals) - 1
        return [
            self._frame(k, nonce, MORE if i < last else 0, node, g, y)  # type: ignore[arg-type]
            for i, (node, g, y) in enumerate(arrivals)
        ]

    def record(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Record what was sensed and sent, and trip on a state beyond its limit.

        Args:
            t_ns: nominal time of the slot, ns.
            frames: what :meth:`sense` returned.
        """
        k, journal = self.k, self._journal
        state = self._x = self._plant.state
        if self._faults is not None:
            self._faults.log_events(t_ns, k, journal)
        journal.slot_asked(t_ns, k, state, self._y, self._r, self._sent, frames)
        tripped = self.actuator.watch(state)
        if tripped is not None:
            self._note_trip(t_ns, tripped)
        if self._port is not None:
            put_out, command = self._plant.applied[0], self.actuator.u[0]
            if put_out != command and self._put_out is None and not abs(put_out - command) <= EQUAL * abs(command):
                self._put_out = k, f"what it says that it puts out, {put_out:.3g} for a command of {command:.3g}"
            tripped = self.actuator.update_observer(self._y[self._port], put_out)
            if tripped is not None:
                self._note_trip(t_ns, tripped)

    def on_frame(self, data: bytes) -> bool:
        """Take one frame from the link; return True when it answers the current slot."""
        return self.answers.take(data)

    def actuate(self, t_ns: int) -> None:
        """Let the medium pass what it passes, choose the row, and hold it until the next slot."""
        k = self.k
        packet = self.answers.close()
        if packet is not None and self.answers.usable(packet):
            self._to_actuator.offer(k, packet)
        draws, arrivals = self._to_actuator.collect(k)
        for i, law in self._laws:
            law.take(draws if i == len(self._sensors) else self._sent[i][0])
        applied = self.actuator.apply(k, arrivals, t_ns if self._woken is None else self._woken(t_ns))
        if applied.tripped is not None:
            self._note_trip(t_ns, applied.tripped)
        if self._disturbed:
            self._w = self._disturbance.at(k)
        self._journal.slot_answered(t_ns, k, applied, self._w, draws, packet, self.answers.data)
        self._slots = k + 1
        if self._watch is not None:
            self._watch.take(self._x, self._y, self.actuator.u, self._w)
        if self._end is not None and k >= self._end:
            self._stop()

    def _bus_of(self, loop: Loop, shared: SharedMedium, seed: int) -> CanNetwork:
        from hil.runtime.nodes.can_network import CanNetwork  # the model of a bus is loaded where there is one

        return CanNetwork(loop, shared, seed, self._on_bus, self._bus_status)

    def _on_bus(self, ended: Transmission, node: CanNode) -> None:
        self._journal.bus(max(self.k, 0) * self._period_ns, self.k, ended, node)

    def _bus_status(self, at_ns: int, name: str, node: CanNode) -> None:
        errors = node.errors
        message = f"{name} is {STATES[errors.state]}: TEC {errors.tec}, REC {errors.rec}"
        severity = "info" if errors.state == "active" else "warning"
        self._journal.event(
            max(self.k, 0) * self._period_ns, "bus status", message, slot=self.k, severity=severity, node=name, at_ns=at_ns
        )

    def _note_trip(self, t_ns: int, reason: str) -> None:
        self._end = self.k + self._after_trip
        self._journal.event(t_ns, "safety", f"safe state (zero input, latched): {reason}", slot=self.k, severity="error")

    def compare(self, answers: tuple[int, str] | None = None) -> None:
        """Say of a run that has ended whether plant and controller were what they say that they are.

        Args:
            answers: the slot in which the controller left its table, and by how much; None if it did not.
        """
        watch = self._watch or self._past_watch
        plant = None if watch is None else watch.departed() or self._put_out
        watches = [*self._past_laws, *(law for _, law in self._laws)]
        laws = [(f"the network law {law.name} left its chain", law.departed()) for law in watches]
        for what, departed in (("the plant left its model", plant), ("the controller left its table", answers), *laws):
            if departed is not None:
                k, by = departed
                kind, claim = (WITHDRAWN, "certificate withdrawn: ") if self._claimed else (DEPARTED, "")
                message = f"{claim}{what} at slot {k} by {by}"
                self._journal.event(max(self.k, 0) * self._period_ns, kind, message, slot=k, severity="error")

    def outcome(self) -> dict[str, Any]:
        """Return the counters that the summary needs; a slot that was cut off by a signal is none."""
        return {"slots": self._slots, **self.answers.outcome(), "safety": self.actuator.tripped}
