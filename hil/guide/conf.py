"""How Sphinx renders the guide and the API reference: `make docs`."""

project = "hilrig"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "hilrig"
exclude_patterns = ["conf.py"]
autodoc_member_order = "groupwise"
napoleon_use_ivar = True


def setup(app):
    """Take the bars of |x| as what they are: reStructuredText would look for a substitution."""
    app.connect("autodoc-process-docstring", lambda app, what, name, obj, options, lines: lines.__setitem__(
        slice(None), [line.replace("|", r"\|") for line in lines]))  # fmt: skip
