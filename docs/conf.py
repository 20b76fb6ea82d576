"""How Sphinx makes the site of `make docs`; docs/decisions/074 says why so."""

from roadsight import __version__

project = "roadsight"
author = "The roadsight developers"
copyright = author  # noqa: A001
version = release = __version__
html_title = "roadsight"

extensions = ["myst_parser", "scripts.pages.formulas"]
myst_enable_extensions = ["dollarmath"]
myst_dmath_double_inline = False
myst_heading_anchors = 4
html_math_renderer = "mathml"

html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_use_index = False
language = "en"
