"""The manual, built by Sphinx.

    pip install -r docs/requirements.txt ./src/python
    sphinx-build -W docs target/manual          # target/manual/index.html

Pages under docs/generated are made by pages.py from what cannot go stale: the sections of README.md, the types of
scenes, and `--help` of every command.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent))

import pages  # noqa: E402  (beside this file)

pages.write()

project = "whirls"
author = "the authors of whirls"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
root_doc = "index"
exclude_patterns = ["requirements.txt", "public-face.txt", "equations.md", "__pycache__"]
html_theme = "furo"
html_title = "whirls"
html_static_path = []
html_show_copyright = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# Rust code of README is shown, not checked here: `cargo test` runs it.
highlight_language = "text"
suppress_warnings = ["misc.highlighting_failure"]
