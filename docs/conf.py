"""How the documentation site is built: ``python -m sphinx -W --keep-going docs build/site``."""

import os
import re
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "agg")
sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import matplotlib
from sphinx_gallery.sorting import ExplicitOrder

import servoscope

project = "servoscope"
author = "The servoscope developers"
copyright = f"2026, {author}"
version = release = servoscope.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "site_check",
]
templates_path = ["_templates"]
exclude_patterns = ["_templates", "_ext", "gallery/*.ipynb", "gallery/*.py"]
nitpicky = True
highlight_language = "none"
pygments_style = "friendly"

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4  # the anchors that GitHub makes of headings

autosummary_generate = True
autodoc_typehints = "none"  # docstrings say the types
autodoc_default_options = {
    "exclude-members": "set_fit_request, set_predict_request, set_transform_request, "
    "set_score_request, get_metadata_routing, get_params, set_params, set_output, score",
}
numpydoc_show_class_members = False

EXAMPLES = (
    "plot_information",
    "plot_keyframe",
    "plot_assess",
    "plot_position",
    "plot_rehearse",
    "plot_own_features",
    "plot_own_robot",
    "own_images",
    "own_robot",
    "more_features",
    "small_model",
)
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "ignore_pattern": r"__init__\.py|/cpp/",
    "within_subsection_order": ExplicitOrder([f"{name}.py" for name in EXAMPLES]),
    "abort_on_example_error": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
    "image_srcset": ["2x"],
    "min_reported_time": 1,
}
suppress_warnings = ["config.cache"]

html_theme = "pydata_sphinx_theme"
html_title = "servoscope"
html_static_path = ["_static", f"{matplotlib.get_data_path()}/fonts/ttf/STIXGeneral.ttf"]
html_context = {"default_mode": "auto"}
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "logo": {"text": "servoscope"},
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}

# Addresses elsewhere are looked up where the network is there, not in continuous integration.
linkcheck_ignore = [r"https?://(127\.0\.0\.1|localhost|192\.0\.2\.).*"]
if os.environ.get("CI"):
    linkcheck_ignore.append(r"https?://.*")


def escape_fitted_names(app, what, name, obj, options, lines):
    """In a shape ``(n_features_in_,)`` is a name, not a link."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith(">>>"):
            lines[i] = re.sub(r"(\w)_(?=,\)|\))", r"\1\\_", line)


def setup(app):
    app.connect("autodoc-process-docstring", escape_fitted_names, priority=400)
