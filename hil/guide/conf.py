"""How Sphinx renders the guide: `make docs`."""

project = "hilrig"
extensions = ["myst_parser"]
html_theme = "furo"
html_title = "hilrig"
exclude_patterns = ["conf.py"]
