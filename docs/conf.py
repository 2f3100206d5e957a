"""Sphinx: the pages in Markdown as they are, a reference from docstrings, and examples that are run on the way.

`make docs` calls it with the repository's root as the source, so that pages link to each other as they do there.
"""

from sphinx_gallery.sorting import ExplicitOrder

import softslide

project = "softslide"
author = "softslide contributors"
release = softslide.__version__
copyright = "softslide contributors, MIT licence"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
root_doc = "docs/index"
include_patterns = [
    *("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "experiments/LOG.md"),
    *("pipeline/presses/README.md", "docs/*.md", "docs/gallery/**"),
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_heading_anchors = 3
# What stands in single backticks in a docstring.
default_role = "code"

html_theme = "furo"
html_title = "softslide"
html_show_sphinx = False

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"

# In the order in which they are best read.
EXAMPLES = ("slide", "features", "train", "abstention", "path", "mujoco_ball")
sphinx_gallery_conf = {
    "examples_dirs": ["docs/examples"],
    "gallery_dirs": ["docs/gallery"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": ExplicitOrder([f"{name}.py" for name in EXAMPLES]),
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "remove_config_comments": True,
    "abort_on_example_error": True,
}
