"""Sphinx: the pages of this folder, the demos as tutorials, and what is generated from the package."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

import generate  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402

import valvefsi  # noqa: E402
from valvefsi.runtime import dolfinx_compat  # noqa: E402, F401  (before any module that imports DOLFINx)

generate.everything(HERE / "generated")

project = "valvefsi"
author = "the valvefsi developers"
release = version = valvefsi.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["results"]
html_theme = "furo"
html_title = f"valvefsi {release}"
html_static_path: list[str] = []

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3

napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {
    "members": True,
    "show-inheritance": False,
    "exclude-members": "set",
}  # matplotlib writes it anew in each class of figures


def setup(app: Sphinx) -> None:
    """Set formulas of the docstrings as literal blocks."""
    app.connect("autodoc-process-docstring", generate.set_formulas)
