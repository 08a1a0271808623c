"""The page of a folder of logs: all are listed, each has its page, a damaged one says why, and the table chooses curves."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import hil
from tests.hil.pages import chromium


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        hil.run("dc-motor-hinf", seed=seed, duration=2, log=found / f"motor-{seed}.mcap")
    hil.run("omni-push", duration=1, log=found / "omni.mcap")
    (found / "torn.mcap").write_bytes(b"no log" * 9)
    return found


def test_a_folder_has_a_page_and_each_log_its_own(folder: Path) -> None:
    written = hil.report(folder, force=True)
    assert written[0] == folder / "index.html"
    page = written[0].read_text()
    for name in ("motor-0", "motor-1", "omni"):
        assert f'<a href="{name}.html">{name}.mcap</a>' in page and (folder / f"{name}.html").exists()
    assert "torn.mcap" in page and "is no MCAP file" in page and not (folder / "torn.html").exists()
    assert "certified: passivity" in page and "squared tracking error (rad² s)" in page


def test_pages_are_made_again_only_where_the_log_is_newer_and_never_over_other_files(folder: Path) -> None:
    hil.report(folder, force=True)
    index = folder / "index.html"
    index.write_text("my notes")
    with pytest.raises(hil.HilError, match="exists already and is no report"):
        hil.report(folder)
    assert index.read_text() == "my notes"
    assert len(hil.report(folder, force=True)) == 1
    log = folder / "omni.mcap"
    os.utime(log, ns=(log.stat().st_mtime_ns + 10**12,) * 2)
    assert hil.report(folder, force=True)[1:] == (folder / "omni.html",)
    (folder / "omni.html").write_text("my notes")
    os.utime(folder / "omni.html", ns=(0, 0))
    assert len(hil.report(folder, force=True)) == 1
    assert (folder / "omni.html").read_text() == "my notes" and 'href="omni.html"' not in (folder / "index.html").read_text()
    os.utime(folder / "omni.html")  # newer than the log, and still no page of it
    hil.report(folder, force=True)
    assert 'href="omni.html"' not in (folder / "index.html").read_text()
    (folder / "omni.html").unlink()
    (elsewhere,) = hil.report(folder, output=folder.parent / "all.html", force=True)
    assert "href=" not in elsewhere.read_text().split("<main>")[1].split("<footer>")[0]


def test_a_folder_without_logs_and_options_of_one_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(hil.HilError, match=r"holds no \.mcap file"):
        hil.report(tmp_path)
    with pytest.raises(hil.HilError, match="figures: belongs to the page of a run"):
        hil.report(tmp_path, figures=tmp_path)


@pytest.mark.chromium
def test_rows_are_filtered_and_choose_curves(folder: Path, browser: chromium.Page) -> None:
    index, *_ = hil.report(folder, force=True)
    browser.size(390, 900)
    browser.open(index)
    assert browser.evaluate("document.querySelector('td:has(input)').clientWidth") < 50, "a tick takes no room of its log"
    assert browser.evaluate("document.querySelector('.search [role=status]').getClientRects().length") == 1, "on one line"
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    browser.size(1280, 900)
    browser.open(index)
    rows = "[...document.querySelectorAll('table[data-searched] tbody tr')]"
    seen = f"{rows}.filter(r => !r.hidden).map(r => r.cells[1].textContent)"
    assert browser.evaluate(seen) == ["motor-0.mcap", "motor-1.mcap", "omni.mcap", "torn.mcap"]
    field = "document.querySelector('[type=search]')"
    browser.evaluate(f"(i => {{ i.value = 'hinf motor-1'; i.dispatchEvent(new Event('input')); }})({field})")
    assert browser.evaluate(seen) == ["motor-1.mcap"]
    shown = "hilPlots().slice(0, 2).map(p => p.series.slice(1).map(s => s.show))"
    assert browser.evaluate(shown) == [[True, True], [True]]
    browser.evaluate(f"{rows}[1].querySelector('input').click()")
    assert browser.evaluate(shown) == [[False, True], [False]]
    browser.evaluate(f"{rows}[0].querySelector('input').click()")
    said = browser.evaluate("document.querySelector('.differences').textContent")
    assert said.startswith("motor-0.mcap minus motor-1.mcap: ") and "squared tracking error (rad² s) " in said
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
