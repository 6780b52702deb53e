"""Settings of Sphinx for the pages that `build.py` puts together."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "mbd_ros"
html_title = "mbd_ros"
author = "mbd_ros maintainers"
project_copyright = "mbd_ros maintainers, Apache-2.0"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "docstrings"]
html_theme = "furo"
html_show_sphinx = False
html_copy_source = False
pygments_style, pygments_dark_style = "friendly", "github-dark"

myst_heading_anchors = 4  # `page.md#a-heading`, as code hosts have it
html_math_renderer = "mathml"
myst_fence_as_directive = ["math"]

default_role = "literal"  # `names` in docstrings
add_module_names = False
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar = True

html_static_path = ["static"]
html_css_files = ["equations.css"]
