"""The shell of every page: one self-contained HTML file that asks no network for anything.

Styles, script, uPlot and the data stand inside the file. A content security policy allows exactly these scripts (by
their SHA-256) and no connection, so that even text that slipped through escaping could not run or call out.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from html import escape
from importlib.resources import files
from typing import Final

from hil.pages.html.figures import Badge, Section, Tile
from hil.pages.html.payload import Payload
from hil.pages.html.render_block import badge_html, block_html, tile_html

SCRIPTS: Final = ("save.js", "save_curves.js", "save_still.js", "page.js")
"""Ours, in the order in which the later ones need the earlier."""


@dataclass(frozen=True, slots=True)
class Page:
    """One self-contained HTML page; all strings are shown literally.

    Args:
        title: heading and window title.
        sections: what the page shows, in order; each becomes an entry of the navigation line.
        kicker: small line above the title, e.g. "hilrig · run report".
        subtitle: a sentence below the title.
        badges: verdicts in the page's head.
        tiles: the few numbers that matter, set large.
        facts: (name, value) pairs in the head, e.g. ("seed", "0").
        footer: a closing line, e.g. the version that wrote the page.
        scripts: more of ours that this page needs, names of assets.
    """

    title: str
    sections: Sequence[Section]
    _: KW_ONLY
    kicker: str = "hilrig"
    subtitle: str = ""
    badges: Sequence[Badge] = ()
    tiles: Sequence[Tile] = ()
    facts: Sequence[tuple[str, str]] = ()
    footer: str = ""
    scripts: Sequence[str] = ()

    def html(self) -> str:
        """Return its text.

        Raises:
            ValueError: a series has x and y of different shapes.
            TypeError: a block is unknown.
        """
        payload = Payload()
        body = "".join(_section(i, section, payload) for i, section in enumerate(self.sections))
        library, script = _asset("uPlot.iife.min.js"), "\n".join(map(_asset, (*SCRIPTS, *self.scripts)))
        policy = (
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
            f"script-src {_digest(library)} {_digest(script)}"
        )
        links = "".join(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(self.sections))
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n'
            f"<title>{escape(self.title)}</title>\n<style>{_asset('uPlot.min.css')}\n{_asset('page.css')}</style>\n</head>\n<body>\n"
            f'{_header(self)}\n<nav aria-label="Sections"><div>{links}'
            '<button id="reset" type="button" hidden>Reset zoom</button></div></nav>\n'
            f"<main>\n<noscript><p>The curves of this page are drawn by a script inside it.</p></noscript>\n{body}</main>\n"
            f"<footer>{escape(self.footer)}</footer>\n"
            f'<script type="application/json" id="hil-data">{payload.json()}</script>\n'
            f"<script>{library}</script>\n<script>{script}</script>\n</body>\n</html>\n"
        )


def _header(page: Page) -> str:
    parts = [f'<div class="kicker">{escape(page.kicker)}</div>', f"<h1>{escape(page.title)}</h1>"]
    if page.subtitle:
        parts.append(f'<p class="subtitle">{escape(page.subtitle)}</p>')
    if page.badges:
        parts.append(f'<div class="badges">{"".join(map(badge_html, page.badges))}</div>')
    if page.facts:
        pairs = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in page.facts)
        parts.append(f'<dl class="facts">{pairs}</dl>')
    if page.tiles:
        parts.append(f'<div class="tiles">{"".join(map(tile_html, page.tiles))}</div>')
    return f"<header>{''.join(parts)}</header>"


def _section(number: int, section: Section, payload: Payload) -> str:
    intro = f'<p class="intro">{escape(section.intro)}</p>' if section.intro else ""
    blocks = "\n".join(block_html(block, payload) for block in section.blocks)
    columns = min(max(section.columns, 1), 3)
    return (
        f'<section id="s{number}"><h2>{escape(section.title)}</h2>{intro}'
        f'<div class="grid columns-{columns}">{blocks}</div></section>\n'
    )


def _asset(name: str) -> str:
    # A "</script" in a script would end its element early; uPlot and ours have none, and a test holds them to it.
    return files("hil.pages.html").joinpath("assets", name).read_text(encoding="utf-8").strip()


def _digest(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
