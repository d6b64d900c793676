"""Sphinx configuration; the build treats warnings as errors."""

from cagemap import __version__

project = "cagemap"
author = "the cagemap authors"
copyright = "the cagemap authors, MIT licence"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
suppress_warnings = ["ref.citation"]  # modules list the literature they stand on, cited or not

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"  # annotations of fields; docstrings add shapes and units
napoleon_google_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"cagemap {__version__}"
html_show_sphinx = False
