"""Which folder of the package imports which, and how long each is (docs/architecture.md).

`python benchmark/structure.py [CHECKOUT]` reads the sources of this checkout or another one. A
module at the top of the package counts as a folder. Folders stand in an order in which each
imports earlier ones only. An `o` in a folder's row says that it imports the folder whose `#`
stands in that column. A circle of imports is printed instead, with exit code 1.
"""

import argparse
import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "star_tracker"


def folder_of(module: str) -> str:
    """Return the folder of a dotted module name, or the module itself where it is at the top."""
    return module.removeprefix(f"{PACKAGE}.").partition(".")[0]


def names_imported(tree: ast.AST) -> set[str]:
    """Return the dotted names that a module imports at its top or in a function."""
    nodes = list(ast.walk(tree))
    plain = {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
    return plain | {
        f"{n.module}.{a.name}" for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names
    }


def read(checkout: Path) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Return the number of lines of each folder, and the folders that it imports."""
    lines: dict[str, int] = {}
    imports: dict[str, set[str]] = {}
    # The adapters are linked into the package, and a search does not follow links.
    roots = (checkout / PACKAGE, checkout / "msg_adapters")
    sources = [path for root in roots for path in root.rglob("*.py")]
    for source in sorted(sources):
        text = source.read_text(encoding="utf-8")
        module = ".".join(source.relative_to(checkout).with_suffix("").parts)
        folder = folder_of(module)
        if folder == "__init__":
            continue
        lines[folder] = lines.get(folder, 0) + text.count("\n")
        found = {
            folder_of(name) for name in names_imported(ast.parse(text))
            if name.startswith(f"{PACKAGE}.")
        }
        imports.setdefault(folder, set()).update(found - {folder, "__init__"})
    return lines, {folder: found & set(lines) for folder, found in imports.items()}


def depth(folder: str, imports: dict[str, set[str]]) -> int:
    """Return the floor of a folder: one above the highest of those that it imports."""
    return max((depth(below, imports) + 1 for below in imports[folder]), default=0)


def main() -> int:
    """Print the drawing."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", type=Path, nargs="?", default=ROOT, help="another checkout")
    lines, imports = read(parser.parse_args().checkout)
    # `commands` imports the nodes only when `watch` runs, `nodes` imports `commands` always.
    imports.get("commands", set()).discard("nodes")
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        print(f"a circle: {' -> '.join(error.args[1])}")
        return 1
    order = sorted(lines, key=lambda folder: (depth(folder, imports), folder))
    wide = max(map(len, order))
    for i, folder in enumerate(order):
        marks = "".join(" o" if below in imports[folder] else " ." for below in order[:i])
        print(f"{folder:{wide}} {lines[folder]:5}{marks} #")
    arrows, floors = sum(map(len, imports.values())), 1 + depth(order[-1], imports)
    n_lines = sum(lines.values())
    print(f"\n{len(order)} folders on {floors} floors, {arrows} arrows, {n_lines} lines")
    return 0


if __name__ == "__main__":
    sys.exit(main())
