"""The documentation as a site: ``./with-dolfinx python3 docs/build.py``. Sphinx with MyST; no network at build or view time."""

project = "fmbd_fenicsx"
author = copyright = "The fmbd_fenicsx developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["scripts", "_build", "README.md"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

html_theme = "furo"
html_title = "fmbd_fenicsx"
html_static_path: list[str] = ["_static"]
html_css_files = ["site.css"]

myst_enable_extensions = ["colon_fence", "attrs_inline"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = True
napoleon_use_ivar = True  # attributes that are properties are described once
nitpicky = False
suppress_warnings = ["myst.header", "docutils", "autodoc", "ref.python", "toc.not_included"]
