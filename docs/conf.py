"""How Sphinx builds these pages: `make docs`, or by hand `sphinx-build docs build/docs`.

Nothing is fetched: no intersphinx, no fonts or scripts from elsewhere. The API comes from the
docstrings; the packages are imported for real, ROS included.
"""

import os
import re
import sys
from enum import Enum
from pathlib import Path
from typing import Generic, TypeVar

CHECKOUT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(CHECKOUT))
# Compiled functions are then the plain functions that they were written as, with their signatures.
os.environ["NUMBA_DISABLE_JIT"] = "1"

import numpy.typing  # noqa: E402

T = TypeVar("T")


class NDArray(Generic[T]):
    """Stands for numpy's, whose own alias fills a line of each signature."""

    __module__ = "numpy.typing"


class ArrayLike:
    """Stands for numpy's, whose own alias fills three."""

    __module__ = "numpy.typing"


numpy.typing.NDArray, numpy.typing.ArrayLike = NDArray, ArrayLike

from star_tracker.resources import package_version  # noqa: E402

project = "star_tracker"
author = "star_tracker developers"
copyright = author  # noqa: A001
version = release = package_version()

extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_theme = "furo"
html_title = f"star_tracker {version}"
# A page is known by its name alone, and pages do not show their own source.
html_copy_source = False
# Plain fences hold output of programs, of no language.
highlight_language = "none"

# As GitHub has them: links to headings, and text that is not converted to dashes and quotes.
myst_heading_anchors = 4
smartquotes = False

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
# Docstrings are written for reading in the source: `name` is code.
default_role = "literal"

nitpick_ignore_regex = [
    # Documented elsewhere; a link would need the other projects' indices from the network.
    ("py:.*", r"(numpy|scipy|numba|matplotlib|rich)\..*"),
    ("py:.*", r"(abc|argparse|collections|pathlib|enum|subprocess)\..*"),
    ("py:.*", r"(rclpy|rcl_interfaces|\w+_msgs|std_srvs)\..*"),
    ("py:class", "Node"),  # of rclpy, imported where it is used only
    ("py:class", "Client"),  # of distributed, in the same way
    # Type variables and other names of a module's own.
    ("py:.*", r"star_tracker\.(\w+\.)*_\w+"),
]

#: Pages whose text stands elsewhere in the checkout.
_ELSEWHERE = {
    "readme": "README.md", "data": "data/README.md", "benchmark": "benchmark/RESULTS.md",
}
#: `    name: text` in a list of a docstring, or `    name, name: text`.
_ITEM = re.compile(r" {4}(\w+(?:, \w+)*): (.*)")


def list_arguments(app, what, name, obj, options, lines):
    """Turn the lists below `Args:` and `Attributes:` into definition lists.

    Not napoleon: it takes what stands before a colon in any attribute's docstring for a type.
    """
    inside, result = False, []
    for line in lines:
        item = _ITEM.fullmatch(line) if inside else None
        if line in ("Args:", "Attributes:"):
            inside = True
            result += [f"**{line[:-1]}**", ""]
        elif item:
            result += [", ".join(f"``{word}``" for word in item[1].split(", ")), f"    {item[2]}"]
        elif inside and line.startswith(" " * 8):
            result.append(f"    {line.strip()}")
        else:
            inside = inside and not line
            result.append(line)
    lines[:] = result


def name_factories(*event):
    """Make signatures readable for Sphinx whose defaults come from a factory."""
    *_, signature, returns = event
    return signature and signature.replace("<factory>", "..."), returns


def skip(app, what, name, obj, skipped, options):
    """Leave out what only says `Alias for field number 0`, but not the members of an enum."""
    if type(obj).__name__ == "_tuplegetter":
        return True
    return False if isinstance(obj, Enum) else None


def put_in(app, docname, source):
    """Give the pages that stand elsewhere their text, and links to them their page here."""
    if docname in _ELSEWHERE:
        path = CHECKOUT / _ELSEWHERE[docname]
        source[0] = path.read_text(encoding="utf-8").replace("](docs/", "](")
    for page, path in _ELSEWHERE.items():
        source[0] = re.sub(rf"]\((\.\./)?{re.escape(path)}", f"]({page}.md", source[0])


def list_modules(app, docname, source):
    """Give the API page of a folder the documentation of each module in it."""
    section, _, folder = docname.partition("/")
    if section != "api" or folder == "index":
        return
    if folder == "top":
        paths = CHECKOUT.glob("star_tracker/[!_]*.py")
    else:
        paths = (CHECKOUT / "star_tracker" / folder).rglob("*.py")
    names = [".".join(path.relative_to(CHECKOUT).with_suffix("").parts) for path in paths]
    for name in sorted(name.removesuffix(".__init__") for name in names):
        source[0] += f"\n## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"


def setup(app):
    """Register what is above."""
    app.connect("autodoc-process-docstring", list_arguments)
    app.connect("autodoc-process-signature", name_factories)
    app.connect("autodoc-skip-member", skip)
    app.connect("source-read", put_in)
    app.connect("source-read", list_modules)
