"""How Sphinx renders the guide and the API reference: `make docs`."""

from typing import Any

project = "hilrig"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "hilrig"
autodoc_member_order = "groupwise"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_use_ivar = True


def setup(app: Any) -> None:
    """Take the bars of |x| as what they are: reStructuredText would look for a substitution."""
    app.connect("autodoc-process-docstring", lambda app, what, name, obj, options, lines: lines.__setitem__(
        slice(None), [line.replace("|", r"\|") for line in lines]))  # fmt: skip
