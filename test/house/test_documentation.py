"""The pages of docs/: all folders are in the API reference, all pages in the contents.

That the pages build without a warning or a broken reference is held by `make lint`.
"""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_each_folder_has_its_page_of_the_api_reference():
    """The page lists the modules of the folder by itself (docs/conf.py)."""
    folders = {path.parent.name for path in (ROOT / "star_tracker").glob("*/__init__.py")}
    pages = {path.stem for path in (DOCS / "api").glob("*.md")}
    assert pages == folders | {"msg_adapters", "top", "index"}
    text = (DOCS / "api" / "index.md").read_text()
    contents = re.search(r"```\{toctree\}\n:maxdepth: 2\n\n(.*?)```", text, re.DOTALL)[1].split()
    assert sorted(contents) == sorted(pages - {"index"})


def test_each_page_is_in_the_contents_and_on_the_first_page():
    text = (DOCS / "index.md").read_text()
    contents = re.search(r"```\{toctree\}\n:hidden:\n\n(.*?)```", text, re.DOTALL)[1].split()
    pages = {path.stem for path in DOCS.glob("*.*") if path.suffix in (".md", ".rst")} - {"index"}
    assert set(contents) == pages | {"api/index"}
    assert set(re.findall(r"\]\((\S+)\.md\)", text)) == set(contents) - {"changelog"}


def test_the_readme_lists_the_pages():
    section = (ROOT / "README.md").read_text().split("\n## Documentation\n")[1].split("\n## ")[0]
    pages = {path.name for path in DOCS.glob("*.md")}
    elsewhere = {"index.md", "readme.md", "data.md", "benchmark.md"}
    assert set(re.findall(r"\]\(docs/(\S+\.md)\)", section)) == pages - elsewhere
