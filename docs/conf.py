"""How Sphinx makes the site of these pages: ``make docs``.

The source folder is the repository itself, so that pages, pictures and the links between them are those that a code
host shows; nothing is copied. Navigation and the generated reference are in :mod:`docs.site_pages`.
"""

import importlib.metadata
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

project = "panopath"
author = "the panopath contributors"
release = version = importlib.metadata.version("panopath")
project_copyright = "Apache-2.0"
html_title = f"panopath {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "docs.site_pages"]
root_doc = "docs/index"
source_suffix = {".md": "markdown"}
include_patterns = [
    "README.md",
    "CONVENTIONS.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "docs/*.md",
    "docs/**/*.md",
]
# what need not be searched for pages
exclude_patterns = [".*", "target", "site", "dist", "crates", "python", "tests", "benchmarks", "examples", "docs/img"]

myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]
# formulas and what programs print stand as they were written
highlight_language = "text"

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
python_display_short_literal_types = True

nitpicky = True
# names of types in the text of docstrings, and of inner parts that arguments and hidden fields have
inner = ("RenderedWalk", "Names", "Checkpoints", "DecodedFrames", "Content", "Visit")
nitpick_ignore = [("py:class", name) for name in ("Float", "Int", "Bool", "Frame", "Path", "array", "ndarray")]
# names of other projects, which nothing is downloaded to look up
nitpick_ignore_regex = [
    ("py:.*", r"(docs|datetime|numpy|np|npt|os|enum|pathlib|collections|typing|types|viser|pycolmap)\..*"),
    ("py:class", rf"(panopath\..*\.)?({'|'.join(inner)})"),
]

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
