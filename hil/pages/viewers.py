"""Other people's viewers: a run over the Foxglove WebSocket protocol as it goes, and layouts for the topics of a log.

Foxglove and Lichtblick show both; PlotJuggler has plots of a log.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from functools import partial
from threading import Thread
from typing import Any, Final
from xml.etree import ElementTree

from hil.errors import HilError, located
from hil.log import Curve
from hil.log.records import EVENT_SCHEMA, EVENT_SCHEMA_NAME, EVENTS_TOPIC, Channel, Schema
from hil.log.topics import panels
from hil.log.write import PayloadWriter, together
from hil.rig.loop import Loop
from hil.runtime.changes import Changes
from hil.runtime.clock import Clock
from hil.session import Onlooker

PORT: Final = 8765
HOST: Final = "127.0.0.1"
STOPS_S: Final = 0.5
COLOURS: Final = ("#1f77b4", "#7f7f7f", "#17becf", "#d62728", "#2ca02c", "#9467bd")


class Foxglove:
    """Serves the records of one run after the other on loopback; see `hil.session.Onlooker`.

    A viewer that does not keep up loses records: the server drops the oldest that wait, and the run waits for none.

    Args:
        port: 0 for any that is free.

    Raises:
        HilError: foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise HilError("--foxglove: needs foxglove-sdk: pip install 'hilrig[foxglove]'") from error
        logging.getLogger("foxglove").addHandler(logging.NullHandler())  # else it prints a line for each client that breaks off
        self._sdk, self._context = foxglove, foxglove.Context()
        self._channels: list[Any] = []
        self.clock: Clock | None = None  # it paces nothing, and changes nothing
        self.changes: Changes | None = None
        with located(f"--foxglove {port}", RuntimeError, advice="--foxglove 0 takes a free port"):
            self._server = foxglove.start_server(name="hilrig", host=HOST, port=port, context=self._context)
        self.url = f"ws://{HOST}:{self._server.port}"

    def __enter__(self) -> Foxglove:
        return self

    def __exit__(self, *_: object) -> None:
        stop = Thread(target=self._server.stop, daemon=True)  # it waits for each client in the middle of its handshake
        stop.start()
        stop.join(STOPS_S)

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Offer the topics of a run; raw frames stay in the log."""
        for channel in self._channels:
            channel.close()
        signals = {topic: channel.schema for topic, channel in channels.items() if not channel.schema.raw}
        schemas = {topic: (schema.name, schema.text) for topic, schema in signals.items()}
        schemas[EVENTS_TOPIC] = EVENT_SCHEMA_NAME, EVENT_SCHEMA
        made = {topic: self._channel(topic, *schema) for topic, schema in schemas.items()}
        self._channels = list(made.values())
        return {topic: partial(_log, channel.log) for topic, channel in made.items()}

    def _channel(self, topic: str, name: str, text: str) -> Any:
        schema = self._sdk.Schema(name=name, encoding="ros2msg", data=text.encode())
        return self._sdk.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def end(self) -> None:
        """It waits for nothing."""


def _log(log: Any, t_ns: int, payload: bytes) -> None:
    log(payload, log_time=t_ns)


class Beside:
    """An onlooker, and another one that only looks; see `hil.session.Onlooker`.

    Args:
        first: paces and changes the run.
        second: gets the records, too.
    """

    def __init__(self, first: Onlooker, second: Onlooker) -> None:
        self._first, self._second = first, second
        self.end = first.end

    @property
    def clock(self) -> Clock | None:
        """That of the first."""
        return self._first.clock

    @property
    def changes(self) -> Changes | None:
        """Those of the first."""
        return self._first.changes

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Let both look; when the first one says that the run goes on, the second one has its topics."""
        beside = self._second.begin(loop, channels)
        return together(self._first.begin(loop, channels), beside)


def foxglove(schemas: Mapping[str, Schema]) -> str:
    """Return a layout of Foxglove and Lichtblick, JSON: a plot above the other, the events beside them.

    Args:
        schemas: topic to schema, of a log or of an experiment's channels.

    Reference:
        Lichtblick, packages/suite-base/src: context/CurrentLayoutContext/actions.ts (`LayoutData`), panels/Plot/utils/config.ts
        (`PlotConfig`, `PlotPath`), panels/RawMessages/types.ts; packages/message-path/src/grammar.ne (the paths).
    """
    configs: dict[str, Any] = {}
    for i, (title, curves) in enumerate(_titled(schemas).items()):
        configs[f"Plot!{i}"] = {
            "foxglovePanelTitle": title,
            "paths": [
                {"value": f"{topic}.{c.field}", "label": f"{topic} {c.field}", "enabled": True, "timestampMethod": "receiveTime"}
                for topic, c in curves
            ],
            "showXAxisLabels": True, "showYAxisLabels": True, "showLegend": True, "legendDisplay": "floating",
            "showPlotValuesInLegend": True, "isSynced": True, "xAxisVal": "timestamp", "sidebarDimension": 240,
        }  # fmt: skip
    plots = _stacked(list(configs))
    configs["RawMessages!events"] = {
        "topicPath": EVENTS_TOPIC, "diffEnabled": False, "diffMethod": "previous message", "diffTopicPath": "",
        "showFullMessageForDiff": False,
    }  # fmt: skip
    layout = {"direction": "row", "first": plots, "second": "RawMessages!events", "splitPercentage": 75}
    return json.dumps(
        {
            "configById": configs, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}, "layout": layout,
        },
        indent=1,
    )  # fmt: skip


def plotjuggler(schemas: Mapping[str, Schema]) -> str:
    """Return a layout of PlotJuggler, XML: one tab, a plot above the other, times from the beginning of the log.

    Args:
        schemas: topic to schema, of a log or of an experiment's channels.

    Reference:
        PlotJuggler, plotjuggler_app: mainwindow.cpp, plot_docker.cpp and plotwidget.cpp, each `xmlLoadState`.
    """
    found = _titled(schemas)
    root = ElementTree.Element("root")
    tabs = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    container = ElementTree.SubElement(ElementTree.SubElement(tabs, "Tab", tab_name="hilrig", containers="1"), "Container")
    sizes = ";".join([f"{1 / len(found):.6f}"] * len(found))
    splitter = ElementTree.SubElement(container, "DockSplitter", orientation="-", count=str(len(found)), sizes=sizes)
    for title, curves in found.items():
        area = ElementTree.SubElement(splitter, "DockArea", name=title)
        plot = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        ElementTree.SubElement(plot, "limitY")
        for i, (topic, curve) in enumerate(curves):
            ElementTree.SubElement(plot, "curve", name=f"{topic}/{curve.field}", color=COLOURS[i % len(COLOURS)])
    ElementTree.SubElement(tabs, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _titled(schemas: Mapping[str, Schema]) -> dict[str, list[tuple[str, Curve]]]:
    """Return the plots of a log; the title of a plot of one signal has its unit."""
    units = {f.name: f", {f.unit}" for schema in schemas.values() for f in schema.fields if f.unit != "1"}
    return {title + units.get(title, ""): curves for title, curves in panels(schemas).items()}


def _stacked(names: Sequence[str]) -> Any:
    """Return panels one above the other, all of one height."""
    if len(names) == 1:
        return names[0]
    rest = _stacked(names[1:])
    return {"direction": "column", "first": names[0], "second": rest, "splitPercentage": round(100 / len(names), 3)}
