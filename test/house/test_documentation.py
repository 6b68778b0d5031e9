"""The pages of docs/: all modules are in the API reference, all pages in the contents.

That the pages build without a warning or a broken reference is held by `make lint`.
"""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_each_module_is_in_the_api_reference_once():
    pages = (DOCS / "api").glob("*.md")
    documented = re.findall(
        r"^\.\. automodule:: (\S+)$", "\n".join(page.read_text() for page in pages), re.MULTILINE
    )
    sources = [*(ROOT / "star_tracker").rglob("*.py"), *(ROOT / "msg_adapters").rglob("*.py")]
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in sources
    ]
    assert sorted(documented) == sorted(modules)


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
