"""What people look at: metrics of a run, self-contained pages, the live view in the terminal.

`figures` holds the plain data that a page can show, `page.render_page` draws it. Import from the files; this package
imports none of them, so that the live view does not pay for the pages.
"""
