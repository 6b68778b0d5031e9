"""The pages of docs/: all folders are in the API reference, all pages in the contents.

That the pages build without a warning or a broken reference is held by `make lint`.
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_each_folder_has_its_page_of_the_api_reference():
    """The page lists the modules of the folder by itself (docs/conf.py)."""
    folders = {path.parent.name for path in (ROOT / "star_tracker").glob("*/__init__.py")}
    pages = {path.stem for path in (DOCS / "api").glob("*.md")}
    assert pages == folders | {"top", "index"}
    text = (DOCS / "api" / "index.md").read_text()
    contents = re.search(r"```\{toctree\}\n:maxdepth: 2\n\n(.*?)```", text, re.DOTALL)[1].split()
    assert sorted(contents) == sorted(pages - {"index"})


def test_each_page_is_in_the_contents_and_on_the_first_page():
    text = (DOCS / "index.md").read_text()
    contents = re.search(r"```\{toctree\}\n:hidden:\n\n(.*?)```", text, re.DOTALL)[1].split()
    pages = {path.stem for path in DOCS.glob("*.*") if path.suffix in (".md", ".rst")} - {"index"}
    assert set(contents) == pages | {"api/index"}
    assert set(re.findall(r"\]\((\S+)\.md\)", text)) == set(contents) - {"changelog"}


def test_each_link_leads_to_a_file_or_heading():
    pages = [ROOT / "README.md", *DOCS.glob("*.md"), ROOT / "data/README.md"]
    for page in pages:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        for link in re.findall(r"\]\((?!\w+:)(.*?)\)", text):
            name, _, heading = link.partition("#")
            target = page.parent / name if name else page
            assert target.is_file(), f"{page.name}: {link}"
            assert not heading or heading in anchors(target), f"{page.name}: {link}"


def anchors(page):
    """Return what GitHub calls the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_each_dependency_has_its_line():
    page = (DOCS / "dependencies.md").read_text()
    named = set(re.findall(r"`([\w-]+)`", page))
    for keyword in ast.parse((ROOT / "setup.py").read_text()).body[-1].value.keywords:
        if keyword.arg in ("install_requires", "extras_require"):
            wanted = re.findall(r"'([A-Za-z][\w-]*)", ast.unparse(keyword.value))
            assert set(wanted) <= named


def test_each_dependency_has_its_names_for_apt_and_rosdep():
    page = (DOCS / "dependencies.md").read_text()
    tables, names = page.split("## Names for apt and rosdep")
    libraries = re.findall(r"^\| (?:`[\w-]+` \| )?((?:`[\w-]+`,? ?)+) \|", tables, re.MULTILINE)
    wanted = {name for cell in libraries for name in re.findall(r"`([\w-]+)`", cell)}
    rows = re.findall(r"^\| `([\w-]+)` \| (\S+).* \| \S+ \|$", names, re.MULTILINE)
    assert {name for name, _ in rows} == wanted
    keys = {key for _, key in rows}
    package = (ROOT / "package.xml").read_text(encoding="utf-8")
    assert set(re.findall(r"_depend>(python3-\S+)<", package)) <= keys
