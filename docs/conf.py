"""Sphinx: the site is built by `make -C docs html`; pages that scripts write are made first."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx

import karolos

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_scripts"))

project = "karolos"
version = release = karolos.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton", "sphinx_design"]
myst_enable_extensions = ["colon_fence"]
exclude_patterns = ["_build", "_scripts"]
default_role = "code"
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("ArrayLike", "Listener", "Array", "FloatArray", "BoolArray")}
smartquotes = False
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
copybutton_exclude = ".linenos, .gp, .go"
copybutton_selector = "div.highlight-sh pre, div.highlight-python pre, div.highlight-yaml pre"
html_title = f"karolos {release}"
html_copy_source = False
html_show_sphinx = html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Write the generated pages before Sphinx looks for pages."""
    import pages  # noqa: PLC0415

    app.connect("builder-inited", lambda _: pages.write(HERE / "generated"))
