"""Layouts of other people's viewers for the topics of a log: panels of Foxglove and Lichtblick, plots of PlotJuggler."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final
from xml.etree import ElementTree

from hil.log.records import EVENTS_TOPIC, Schema
from hil.log.topics import panels

COLOURS: Final = ("#1f77b4", "#7f7f7f", "#17becf", "#d62728", "#2ca02c", "#9467bd")


def foxglove(schemas: Mapping[str, Schema]) -> str:
    """Return a layout of Foxglove and Lichtblick, JSON: a plot above the other, the events beside them.

    Args:
        schemas: topic to schema, of a log or of an experiment's channels.

    Reference:
        Lichtblick, packages/suite-base/src: context/CurrentLayoutContext/actions.ts (`LayoutData`), panels/Plot/utils/config.ts
        (`PlotConfig`, `PlotPath`), panels/RawMessages/types.ts; packages/message-path/src/grammar.ne (the paths).
    """
    configs: dict[str, Any] = {}
    for i, (title, curves) in enumerate(panels(schemas).items()):
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
    found = panels(schemas)
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


def _stacked(names: Sequence[str]) -> Any:
    """Return panels one above the other, all of one height."""
    if len(names) == 1:
        return names[0]
    rest = _stacked(names[1:])
    return {"direction": "column", "first": names[0], "second": rest, "splitPercentage": round(100 / len(names), 3)}
