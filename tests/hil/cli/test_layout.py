"""`hil layout`: what a viewer is to draw stands in a real log."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from hil.bench.probe import Trip, write_probe_log
from hil.log.read import read_run
from hil.log.records import EVENTS_TOPIC
from tests.hil.cli.conftest import Hil

# What the viewers read, from their sources: Lichtblick's LayoutData, PlotConfig, PlotPath and RawMessagesPanelConfig.
LAYOUT = {"configById", "layout", "globalVariables", "playbackConfig", "userNodes"}
PLOT = {"paths", "showLegend", "legendDisplay", "showPlotValuesInLegend", "showXAxisLabels", "showYAxisLabels", "isSynced",
        "xAxisVal", "sidebarDimension", "foxglovePanelTitle"}  # fmt: skip
PATH = {"value", "enabled", "label", "timestampMethod"}
RAW_MESSAGES = {"topicPath", "diffEnabled", "diffMethod", "diffTopicPath", "showFullMessageForDiff"}
MESSAGE_PATH = re.compile(r"(/[a-zA-Z0-9_-]+)+\.[a-zA-Z0-9_-]+")  # a topic and a name, as packages/message-path parses them

# The elements and attributes of PlotJuggler's xmlLoadState that a plot over time has.
ELEMENTS = {
    "root": set(), "tabbed_widget": {"parent", "name"}, "Tab": {"tab_name", "containers"}, "Container": set(),
    "DockSplitter": {"orientation", "count", "sizes"}, "DockArea": {"name"}, "plot": {"mode", "style", "flip_x", "flip_y"},
    "limitY": set(), "curve": {"name", "color"}, "currentTabIndex": {"index"}, "use_relative_time_offset": {"enabled"},
}  # fmt: skip


NO_PLOT = "none of its topics is plotted over time; expected an experiment, or the log of a run"


def leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]


def test_a_layout_names_topics_and_fields_of_a_real_log(hil_log: Path, cli: Hil) -> None:
    fields = {topic: {f.name for f in schema.fields} for topic, schema in read_run(hil_log).schemas.items()}
    status, out, _ = cli("layout", "foxglove", hil_log)
    layout = json.loads(out)
    assert status == 0 and sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    assert all(name in fields[topic] for topic, _, name in (path.rpartition(".") for path in paths))
    for needed in ("/plant/measurement.angle", "/reference.angle", "/actuator/applied.voltage", "/controller/rows.tau"):
        assert needed in paths
    assert cli("layout", "lichtblick", "dc-motor-hinf")[1] == out  # an experiment has the topics of its logs
    status, out, _ = cli("layout", "plotjuggler", hil_log, "-o", "x.xml")
    plots = ElementTree.parse("x.xml")
    curves = [curve.attrib["name"] for curve in plots.iter("curve")]
    assert status == 0 and all(name in fields[topic] for topic, _, name in (curve.rpartition("/") for curve in curves))
    assert {curve.rpartition("/")[::2] for curve in curves} == {path.rpartition(".")[::2] for path in paths}
    splitter = next(plots.iter("DockSplitter"))
    assert int(splitter.attrib["count"]) == len(splitter) == len(layout["configById"]) - 1


def test_a_layout_has_what_the_viewers_read_and_nothing_else(hil_log: Path, cli: Hil) -> None:
    layout = json.loads(cli("layout", "foxglove", hil_log)[1])
    assert set(layout) == LAYOUT
    for name, config in layout["configById"].items():
        assert set(config) == {"Plot": PLOT, "RawMessages": RAW_MESSAGES}[name.partition("!")[0]]
        assert not name.startswith("Plot") or all(config[key] is True for key in PLOT if key.startswith(("show", "is")))
        for path in config.get("paths", []):
            assert set(path) == PATH and path["enabled"] is True and path["timestampMethod"] in ("receiveTime", "headerStamp")
            assert MESSAGE_PATH.fullmatch(path["value"])
    assert layout["configById"]["RawMessages!events"]["topicPath"] == EVENTS_TOPIC
    root = ElementTree.fromstring(cli("layout", "plotjuggler", hil_log)[1])
    assert {element.tag: set(element.attrib) for element in root.iter()} == ELEMENTS
    assert [child.tag for child in root] == ["tabbed_widget", "use_relative_time_offset"]
    (splitter,) = root.iterfind("tabbed_widget/Tab/Container/DockSplitter")
    assert len(splitter.attrib["sizes"].split(";")) == len(splitter) and splitter.attrib["orientation"] in "|-"
    assert all([child.tag for child in area][:2] == ["plot"] for area in splitter)


@pytest.mark.parametrize("viewer", ["foxglove", "plotjuggler"])
def test_a_log_of_a_probe_has_no_layout(cli: Hil, viewer: str) -> None:
    write_probe_log(Path("link.mcap"), "can:hil:x", 1000.0, [Trip(10**6, 2 * 10**6, 3 * 10**6)], one_clock=True)
    assert cli("layout", viewer, "link.mcap")[::2] == (2, f"hil: link.mcap: {NO_PLOT}\n")


def test_a_layout_replaces_nothing_unasked(cli: Hil) -> None:
    Path("x.json").write_text("mine")
    status, _, err = cli("layout", "foxglove", "dc-motor-hinf", "-o", "x.json")
    assert status == 2 and "exists already; choose another name or add --force" in err and Path("x.json").read_text() == "mine"
    assert cli("layout", "foxglove", "dc-motor-hinf", "-o", "x.json", "--force")[0] == 0
    assert "Plot!0" in json.loads(Path("x.json").read_text())["configById"]
