"""The page in a real browser: it draws, it zooms all panels together, it asks the network for nothing."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hil.measure.view import view_of
from hil.pages import Badge, Band, BarGroup, Bars, Figure, Histogram, Marker, Matrix, Section, Series, Table, Tile
from hil.pages.html.page import Page
from hil.pages.run_page import render_report
from tests.hil.pages import chromium
from tests.hil.pages.runs import run_of

pytestmark = pytest.mark.chromium


def page_of_panels() -> str:
    t = np.arange(0.0, 20.0, 1e-3)
    y = np.sin(t)
    angle = Figure(
        title="Angle",
        series=(Series(label="angle", x=t, y=y), Series(label="coarse", x=t[::100], y=y[::100], style="points")),
        bands=(Band(label="spread", x=t[::50], lower=y[::50] - 0.2, upper=y[::50] + 0.2),),
        markers=(Marker(x=3.0, label="</script><script>document.title='owned'</script>", state="bad"),),
    )
    modes = Figure(title="Mode", series=(Series(label="m", x=t, y=np.floor(t) % 3, style="step"),), integer_y=True)
    norm = Series(label="n", x=[0.01, 0.1, 1.0], y=[1.0, 2.0, 3.0])
    alone = Figure(title="Norm", series=(norm,), x_log=True, y_asinh=0.5, sync=None)
    text = "<script>document.title='owned'</script>"
    return Page(text, [Section(title="Panels", blocks=(angle, modes, alone))], subtitle=text).html()


INK = """[...document.querySelectorAll('.plot canvas')].map(c => {
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })"""
BOX = "(r => [r.left, r.top, r.width, r.height])(document.querySelector('.u-over').getBoundingClientRect())"
LEGEND = """[...document.querySelectorAll('.plot')].slice(0, 2).flatMap(
  p => [...p.querySelectorAll('.u-series:not(.quiet) .u-value')].map(v => v.textContent))"""
RANGES = "hilPlots().map(p => [p.scales.x.min, p.scales.x.max])"

LABELS = """(() => {
  const seen = [], draw = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...at) { seen.push(text); draw.call(this, text, ...at); };
  hilPlots()[0].redraw(false, false);
  return new Promise(f => requestAnimationFrame(() => f(seen.filter(text => ["late", "safety", "step"].includes(text))))); })()"""


def test_page_draws_zooms_together_and_stays_off_the_network(tmp_path: Path, browser: chromium.Page) -> None:
    file = tmp_path / "page.html"
    file.write_text(page_of_panels(), encoding="utf-8")
    browser.size(1400, 900)
    browser.open(file)
    assert browser.requests == [file.resolve().as_uri()]
    ink = browser.evaluate(INK)
    assert len(ink) == 3 and all(n > 2000 for n in ink)
    assert browser.evaluate("document.title") != "owned"
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")

    whole = browser.evaluate(RANGES)
    assert whole[0] == pytest.approx([0.0, 19.999], abs=1e-6) and whole[1] == whole[0]
    box = browser.evaluate(BOX)
    y = box[1] + box[3] / 2
    browser.mouse("mouseMoved", box[0] + 0.25 * box[2], y, clicks=0)
    browser.mouse("mousePressed", box[0] + 0.25 * box[2], y)
    browser.mouse("mouseMoved", box[0] + 0.5 * box[2], y)
    browser.mouse("mouseReleased", box[0] + 0.5 * box[2], y)
    zoomed = browser.evaluate(RANGES)
    assert zoomed[0] == pytest.approx([5.0, 10.0], abs=0.1)
    assert zoomed[1] == zoomed[0], "panels of one group zoom together"
    assert zoomed[2] == whole[2], "a panel of its own does not"
    assert browser.evaluate("!document.getElementById('reset').hidden")

    browser.mouse("mouseMoved", box[0] + 0.4 * box[2], y, clicks=0)
    values = browser.evaluate(LEGEND)
    assert values and "–" not in values, "the cursor shows the values of every panel of its group"

    for clicks in (1, 2):
        browser.mouse("mousePressed", box[0] + 0.6 * box[2], y, clicks)
        browser.mouse("mouseReleased", box[0] + 0.6 * box[2], y, clicks)
    assert browser.evaluate(RANGES) == whole, "a double click resets"

    light = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    browser.colour_scheme("dark")
    assert browser.evaluate("getComputedStyle(document.body).backgroundColor") != light
    browser.size(800, 900)
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    browser.pdf(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").stat().st_size > 10_000
    assert browser.problems == []
    assert browser.requests == [file.resolve().as_uri()]


def test_report_of_a_run_draws_every_panel_and_stays_off_the_network(tmp_path: Path, browser: chromium.Page) -> None:
    run = run_of("dc-motor-1khz", 'duration="2 s"', timed=True)
    file = tmp_path / "report.html"
    file.write_text(render_report(view_of(run)), encoding="utf-8")
    browser.size(1400, 900)
    browser.open(file)
    panels = browser.evaluate("document.querySelectorAll('.plot').length")
    ink = browser.evaluate(INK)
    assert len(ink) == panels >= 6 and all(n > 2000 for n in ink)
    ranges = browser.evaluate(RANGES)
    assert all(r == ranges[0] for r in ranges)
    assert browser.problems == []
    assert browser.requests == [file.resolve().as_uri()]


def test_an_amount_stays_on_one_line_on_a_telephone(tmp_path: Path, browser: chromium.Page) -> None:
    rows = [["25 ms", "150", 20, 0.005, "−3.3011e−08 to 3.5942e−08", 0.1, "0.0003 to 0.0004"]] * 2
    heads = ("period", "plant.gain", "runs", "mean", "95 % interval", "difference to the best point", "its 95 % interval")
    file = tmp_path / "page.html"
    table, badge = Table(columns=heads, rows=rows, highlight=(1,)), Badge(label=" ".join(["a label"] * 9), state="good")
    curve = Series(label="test_a.py/test_of_a_long_name" * 3, x=np.arange(3.0), y=np.zeros(3))  # as of a log of pytest
    figure = Figure(title=curve.label, series=(curve,), y_label="y")
    file.write_text(Page("Points", [Section(title="x", blocks=(table, figure))], badges=[badge]).html())
    browser.size(390, 800)
    browser.open(file)
    lines = "[...document.querySelectorAll('td')].map(d => { const r = document.createRange(); r.selectNodeContents(d); "
    lines += "return new Set([...r.getClientRects()].map(b => Math.round(b.top))).size; })"
    assert set(browser.evaluate(lines)) == {1}
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_a_long_number_of_a_tile_stays_in_it(tmp_path: Path, browser: chromium.Page) -> None:
    tiles = [Tile(label="Steady-state error", value=-2.71494e-4, unit="rad²/s²")] * 6
    (file := tmp_path / "page.html").write_text(Page("Tiles", [], tiles=tiles).html())
    browser.size(1200, 800)
    browser.open(file)
    assert browser.evaluate("[...document.querySelectorAll('.tile')].every(t => t.scrollWidth <= t.clientWidth)")


def test_report_of_one_slot_shows_its_samples_as_points(tmp_path: Path, browser: chromium.Page) -> None:
    run = run_of("dc-motor-hinf", 'duration="50 ms"')
    file = tmp_path / "report.html"
    file.write_text(render_report(view_of(run)), encoding="utf-8")
    browser.size(1400, 900)
    browser.open(file)
    assert all(low == -0.5 and high == 0.5 for low, high in browser.evaluate(RANGES))
    assert browser.evaluate("hilPlots().every(p => p.series.slice(1).every(s => s.points.show === true || s.points.show()))")
    assert browser.problems == []


def test_worst_marker_gets_its_label_where_there_is_no_room_for_all(tmp_path: Path, browser: chromium.Page) -> None:
    marks = (
        Marker(x=5.2, label="late", state="warning"),
        Marker(x=5.22, label=""),
        Marker(x=5.25, label="safety", state="bad"),
        Marker(x=9.0, label="step"),
    )
    t = np.arange(0.0, 10.0, 0.1)
    file = tmp_path / "page.html"
    panel = Figure(title="Angle", series=(Series(label="angle", x=t, y=t),), markers=marks)
    file.write_text(Page("Marks", [Section(title="Panels", blocks=(panel,))]).html(), encoding="utf-8")
    browser.size(1400, 900)
    browser.open(file)
    assert browser.evaluate(LABELS) == ["safety", "step"]


def test_report_is_readable_on_a_telephone_and_shows_many_outputs_whole_on_a_desk(tmp_path: Path, browser: chromium.Page) -> None:
    law = 'network.ca.law={kind="iid", probabilities=[0.5, 0.5]}'
    run = run_of("vtol-fault-published", 'duration="1 s"', law, "allow_uncertified=true")
    message = "an input that stayed at its limit for several samples " * 3
    run.events.append({"slot": 1, "t_s": 0.001, "kind": "saturated", "severity": "warning", "message": message, "data": {}})
    file = tmp_path / "report.html"
    file.write_text(render_report(view_of(run)), encoding="utf-8")
    browser.size(390, 900)
    browser.open(file)
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    letters = "[...document.querySelectorAll('svg text')].map(t => parseFloat(getComputedStyle(t).fontSize)"
    assert browser.evaluate(f"Math.min(...{letters} * t.ownerSVGElement.clientWidth / 560))") > 9.0
    assert browser.evaluate("document.querySelector('.prose-last td:last-child').clientWidth") >= 200
    browser.size(1400, 900)
    browser.open(file)
    assert browser.evaluate("(s => s.scrollWidth <= s.clientWidth)(document.querySelector('.wide .scroll'))")


def test_few_bars_are_whole_on_a_telephone(tmp_path: Path, browser: chromium.Page) -> None:
    def ages(n: int) -> Bars:
        return Bars(title=f"{n}", categories=[str(i) for i in range(n)], groups=(BarGroup(label="share", values=[0.1] * n),))

    file = tmp_path / "page.html"
    file.write_text(Page("Bars", [Section(title="x", blocks=(ages(3), ages(20)))]).html(), encoding="utf-8")
    browser.size(390, 800)
    browser.open(file)
    hidden = "[...document.querySelectorAll('.scroll')].map(s => s.scrollWidth - s.clientWidth > 1)"
    assert browser.evaluate(hidden) == [False, True]


def test_numbers_of_an_axis_leave_its_label_free(tmp_path: Path, browser: chromium.Page) -> None:
    t = np.arange(0.0, 10.0, 0.1)
    small = Figure(title="Small", y_label="angle", series=(Series(label="angle", x=t, y=-1e-5 - 1e-9 * np.sin(t)),))
    file = tmp_path / "page.html"
    file.write_text(Page("Small", [Section(title="x", blocks=(small,))]).html(), encoding="utf-8")
    browser.size(390, 800)
    browser.open(file)
    shown = browser.evaluate("hilPlots()[0].axes[1]._values.filter(v => v)")
    assert "−1.0001e−5" in shown and "−1e−5" in shown and len(set(shown)) == len(shown)
    room = "(u => { u.ctx.font = '11px ' + getComputedStyle(document.body).fontFamily; return u.axes[1]._size - 10 - 19 - "
    room += "Math.max(...u.axes[1]._values.map(v => u.ctx.measureText(v || '').width)); })(hilPlots()[0])"
    assert browser.evaluate(room) >= 0


STILLS = (  # boxes, numbers and words of each
    (2, '"lateness (us), from","lateness (us), to",count\n0,1,3\n1,2,0\n2,3,400\n', {"Late", "lateness (us)", "p99"}),
    (6, "age,counted,law\n0,0.25,0.2\n1,0.75,0.8\n", {"Ages", "counted", "law", "0", "1"}),  # two are of the legend
    (4, 'from,to 0,"to 0, expected",to 1,"to 1, expected"\n0,0.1,0.15,0.9,0.85\n1,0.4,0.35,0.6,0.65\n', {"Chain", "0.900"}),
)


def page_of_stills() -> str:
    late = Histogram(title="Late", edges=[0.0, 1.0, 2.0, 3.0], counts=[3, 0, 400], x_label="lateness", x_unit="us",
                     markers=(Marker(x=2.5, label="p99"),))  # fmt: skip
    groups = (BarGroup(label="counted", values=[0.25, 0.75]), BarGroup(label="law", values=[0.2, 0.8], hollow=True))
    chain = Matrix(title="Chain", rows=["0", "1"], columns=["0", "1"], values=[[0.1, 0.9], [0.4, 0.6]],
                   expected=[[0.15, 0.85], [0.35, 0.65]], row_label="from", column_label="to")  # fmt: skip
    ages = Bars(title="Ages", categories=["0", "1"], groups=groups, x_label="age")
    return Page("Still", [Section(title="Plots", blocks=(late, ages, chain))]).html()


SAVE = """((place, kind) => new Promise(done => {
  HTMLAnchorElement.prototype.click = function () { fetched(this.download, this.href); };
  const make = URL.createObjectURL;
  let blob;
  URL.createObjectURL = made => { blob = made; return make(made); };
  const fetched = name => blob.slice(0, 4).arrayBuffer().then(
    head => blob.text().then(text => done([name, text, [...new Uint8Array(head)]])));
  [...document.querySelectorAll('.save')][place].querySelectorAll('button').forEach(b => b.textContent === kind && b.click());
}))(%d, '%s')"""


def test_every_plot_can_be_saved_as_svg_png_and_csv(tmp_path: Path, browser: chromium.Page) -> None:
    file = tmp_path / "page.html"
    file.write_text(page_of_panels(), encoding="utf-8")
    browser.size(1400, 900)
    browser.open(file)
    assert browser.evaluate("document.querySelectorAll('.save').length") == 3
    name, csv, _ = browser.evaluate(SAVE % (0, "CSV"))
    head, *rows = csv.splitlines()
    assert name.endswith("-1.csv") and head == 'time (s),"spread, upper","spread, lower",angle,coarse'
    numbers = np.genfromtxt(rows, delimiter=",")
    known = ~np.isnan(numbers[:, 3])
    assert known.sum() > 500 and np.allclose(numbers[known, 3], np.sin(numbers[known, 0]), atol=1e-3)
    name, svg, _ = browser.evaluate(SAVE % (0, "SVG"))
    drawn = ElementTree.fromstring(svg)
    tags = [element.tag.rpartition("}")[2] for element in drawn.iter()]
    assert name.endswith("-1.svg") and tags.count("path") == 3 and tags.count("circle") > 50 and tags.count("line") == 1
    texts = [element.text for element in drawn.iter() if element.tag.endswith("text")]
    assert {"angle", "coarse", "spread", "time (s)", "10"} <= set(texts)
    name, _, head_of_png = browser.evaluate(SAVE % (0, "PNG"))
    assert name.endswith("-1.png") and head_of_png == [0x89, *b"PNG"]
    assert not browser.problems and browser.requests[0] == file.resolve().as_uri()
    still = tmp_path / "still.html"
    still.write_text(page_of_stills(), encoding="utf-8")
    browser.open(still)
    hollow = browser.evaluate("getComputedStyle(document.querySelector('.bar.hollow')).fill")
    assert hollow in browser.evaluate("getComputedStyle(document.querySelector('.swatch.hollow')).boxShadow")
    for place, (boxes, csv, words) in enumerate(STILLS):
        name, svg, _ = browser.evaluate(SAVE % (place, "SVG"))
        drawn = ElementTree.fromstring(svg)
        fills = [element.get("fill") for element in drawn.iter() if element.tag.endswith("rect")]
        assert len(fills) == 1 + boxes and all(fill.startswith("rgb(") for fill in fills), name  # the first is the ground
        assert words <= {element.text for element in drawn.iter() if element.tag.endswith("text")}
        assert browser.evaluate(SAVE % (place, "CSV"))[1] == csv
        assert browser.evaluate(SAVE % (place, "PNG"))[2] == [0x89, *b"PNG"]
    assert len(set(fills[1:])) == 4  # of the heat map: a colour for each value
    assert not browser.problems
