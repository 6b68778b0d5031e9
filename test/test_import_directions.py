"""Which module may import which: the rooms of the design, read from the sources themselves."""

import ast
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
CORE = CHECKOUT / "star_tracker"
ADAPTERS = CHECKOUT / "msg_adapters"

#: Each module of the core with the modules of the package that it may import.
ROOMS = {
    "spherical": set(),
    "resources": set(),
    "compiled": {"resources"},
    "distortion": {"compiled", "spherical"},
    "attitude": {"compiled", "spherical"},
    "wahba": {"compiled", "spherical"},
    "camera": {"compiled", "distortion", "spherical"},
    "catalog": {"resources", "spherical"},
    "sky_index": {"compiled", "spherical"},
    "pairs": {"catalog", "compiled", "spherical"},
    "patterns": {"spherical"},
    "feature_file": {"catalog", "pairs", "patterns"},
    "database": {"catalog", "feature_file", "pairs", "patterns", "resources", "sky_index"},
    "field": {"camera", "compiled", "distortion", "spherical"},
    "votes": {"compiled", "field", "pairs", "spherical"},
    "match_group": {"compiled", "field", "pairs", "spherical", "votes"},
    "evidence": {"compiled", "spherical"},
    "verification": {
        "camera", "compiled", "evidence", "field", "sky_index", "spherical", "wahba",
    },
    "labels": {"compiled", "evidence", "field", "spherical", "verification", "wahba"},
    "search": {
        "compiled", "field", "match_group", "pairs", "spherical", "verification", "votes", "wahba",
    },
    "radial_cyclic": {"database", "field", "patterns", "spherical"},
    "path": {
        "attitude", "camera", "compiled", "evidence", "field", "labels", "pairs", "search",
        "sky_index", "spherical", "verification",
    },
    "solution": {"attitude", "labels", "match_group", "path", "radial_cyclic"},
    "tracker": {
        "attitude", "camera", "database", "distortion", "evidence", "field", "labels",
        "path", "radial_cyclic", "search", "solution", "spherical", "verification", "votes",
    },
    "frame_file": {"spherical"},
    "star_maps": {"attitude", "camera", "catalog", "resources", "spherical"},
    "attachments": {"camera", "catalog", "spherical", "star_maps"},
    "evaluation": {"camera", "catalog", "solution", "spherical", "star_maps", "tracker"},
    "three_star": {"camera", "spherical"},
    "error_propagation": {"spherical", "three_star"},
    "calibration": {"attitude", "camera", "distortion", "spherical", "wahba"},
    "matched_map": {
        "camera", "catalog", "database", "solution", "spherical", "star_maps", "tracker",
    },
    "focal_length": {"calibration", "camera", "spherical"},
    "prediction": {"spherical"},
    "hints": {"calibration", "camera", "database", "solution", "spherical", "tracker"},
    "cli": {"commands", "resources"},
}
#: What the core may import from elsewhere, beside the standard library.
LIBRARIES = {"numpy", "scipy"}
#: Imports of single rooms: only for users of the contest's own files.
OPTIONAL = {"attachments": {"xlrd"}, "compiled": {"numba"}}
#: The commands may import all of the core, `options` and, each, these libraries.
COMMANDS = {
    "__init__": set(),
    "options": {"rich"},
    "boresight": {"rich"},
    "calibrate": {"rich"},
    "evaluate": {"rich"},
    "geometry": {"rich"},
    "plot": set(),
    "watch": {"rich"},
}
#: The commands that may import the figures too, and only inside of a function.
DRAWING = {"plot"}
#: Each module of the figures with the figures that it may import, and whether it draws. They may
#: import all of the core; nothing else imports matplotlib.
FIGURES = {
    "__init__": (set(), False),
    "style": (set(), True),
    "placement": (set(), False),
    "field_view": (set(), False),
    "sky_grid": (set(), False),
    "sky_survey": (set(), False),
    "field_symbols": ({"field_view", "style"}, True),
    "field_labels": ({"field_symbols", "field_view", "placement", "style"}, True),
    "grid_plot": ({"placement", "sky_grid", "style"}, True),
    "side_panel": ({"field_symbols", "field_view", "style"}, True),
    "field_plot": (
        {"field_labels", "field_symbols", "field_view", "grid_plot", "side_panel", "style"}, True,
    ),
    "sky_map": ({"sky_grid", "sky_survey", "style"}, True),
    "pair_histogram": ({"style"}, True),
}
#: The commands that may import the nodes, and that only when they run: the others need no ROS.
ROS_COMMANDS = {"watch"}
#: The modules of the study: which others of it they may import, and which libraries. They may also
#: import all of the core.
STUDY = {
    "__init__": (set(), set()),
    "contestants": (set(), set()),
    "troubles": (set(), set()),
    "configuration": ({"contestants", "troubles"}, {"yaml"}),
    "chunks": ({"configuration", "contestants", "troubles"}, set()),
    "store": ({"chunks"}, set()),
    "execution": ({"chunks", "store"}, {"joblib", "distributed"}),
    "records": ({"chunks", "configuration", "contestants", "troubles"}, set()),
    "figures": ({"records", "troubles"}, {"PIL", "matplotlib"}),
    "page": (
        {"chunks", "configuration", "figures", "records", "troubles"}, {"jinja2", "numba"},
    ),
}
ROS = {"rclpy", "launch", "launch_ros", "ament_index_python", "tf2_ros", "msg_adapters"}


def imports(source):
    """Return the dotted names that a source imports anywhere, in functions too."""
    return imports_of(ast.parse(source.read_text(encoding="utf-8")))


def imports_of(tree):
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{ast.unparse(node)}: a relative import hides where it goes"
            module = node.module or ""
            # `from star_tracker import match_group` imports a module, not a name in one.
            if module == "star_tracker":
                names |= {f"{module}.{alias.name}" for alias in node.names}
            else:
                names.add(module)
    return names


def rooms_of(names):
    """Return the modules of the core among dotted names."""
    return {name.split(".")[1] for name in names if name.startswith("star_tracker.")}


def tops_of(names):
    return {name.split(".")[0] for name in names}


def modules(folder):
    return sorted(folder.glob("*.py"))


def named(paths):
    return pytest.mark.parametrize("source", paths, ids=[path.stem for path in paths])


def test_every_module_of_the_core_has_its_room():
    assert {path.stem for path in modules(CORE)} - {"__init__"} == set(ROOMS)


@named([path for path in modules(CORE) if path.stem in ROOMS])
def test_a_module_imports_only_the_rooms_it_may(source):
    assert rooms_of(imports(source)) <= ROOMS[source.stem]


@named(modules(CORE / "commands"))
def test_a_command_imports_the_core_and_its_own_libraries(source):
    names = imports(source)
    others = tops_of(names) - sys.stdlib_module_names - {"star_tracker"}
    assert others <= LIBRARIES | COMMANDS[source.stem]
    rooms = set(ROOMS) - {"cli"} | {"commands"}
    figures = {"figures"} if source.stem in DRAWING else set()
    nodes = {"nodes"} if source.stem in ROS_COMMANDS else set()
    assert rooms_of(names) <= rooms | {"study"} | figures | nodes
    commands = {name.split(".")[2] for name in names if name.startswith("star_tracker.commands.")}
    assert commands <= {"options"}


def test_every_figure_has_its_row():
    assert {path.stem for path in modules(CORE / "figures")} == set(FIGURES)


@named([path for path in modules(CORE / "figures") if path.stem in FIGURES])
def test_a_figure_imports_the_core_and_the_figures_below_it(source):
    names = imports(source)
    below, draws = FIGURES[source.stem]
    others = tops_of(names) - sys.stdlib_module_names - {"star_tracker"}
    assert others <= LIBRARIES | ({"matplotlib"} if draws else set())
    assert rooms_of(names) <= set(ROOMS) - {"cli"} | {"figures"}
    figures = {name.split(".")[2] for name in names if name.startswith("star_tracker.figures.")}
    assert figures <= below


@named([path for path in modules(CORE / "figures") if path.stem in FIGURES])
def test_a_figure_does_without_pyplot(source):
    """Its global state asks for a screen and keeps every figure alive."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    named = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert "matplotlib.pyplot" not in imports(source)
    assert "pyplot" not in {alias.name for node in named for alias in node.names}


@named([CORE / "commands" / f"{name}.py" for name in sorted(DRAWING)])
def test_a_command_imports_figures_only_where_it_draws(source):
    """The other commands work without matplotlib, though all are imported."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    at_top = [node.module or "" for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert not [module for module in at_top if module.startswith("star_tracker.figures")]


@named(modules(CORE / "study"))
def test_a_module_of_the_study_imports_the_core_and_what_it_may(source):
    names = imports(source)
    rooms, libraries = STUDY[source.stem]
    others = tops_of(names) - sys.stdlib_module_names - {"star_tracker"}
    assert others <= LIBRARIES | libraries
    assert rooms_of(names) <= set(ROOMS) - {"cli"} | {"study"}
    mine = {name.split(".")[2] for name in names if name.startswith("star_tracker.study.")}
    assert mine <= rooms


@named(modules(CORE))
def test_the_core_imports_no_ros(source):
    tops = tops_of(imports(source))
    assert not tops & ROS
    assert not [name for name in tops if name.endswith(("_msgs", "_interfaces"))]


@named(modules(CORE))
def test_the_core_imports_neither_nodes_nor_adapters(source):
    names = imports(source)
    assert "nodes" not in rooms_of(names)
    assert "msg_adapters" not in tops_of(names)


@named(modules(CORE))
def test_the_core_needs_numpy_and_scipy_only(source):
    others = tops_of(imports(source)) - sys.stdlib_module_names - {"star_tracker"}
    assert others <= LIBRARIES | OPTIONAL.get(source.stem, set())


@named(modules(ADAPTERS))
def test_adapters_import_messages_but_not_rclpy_and_no_node(source):
    names = imports(source)
    assert "rclpy" not in tops_of(names)
    assert "nodes" not in rooms_of(names)
    others = tops_of(names) - sys.stdlib_module_names - {"numpy", "star_tracker", "msg_adapters"}
    assert all(name.endswith("_msgs") for name in others)


def test_the_rooms_have_no_circle():
    """Each module can be read after those that it imports, and before those that import it."""
    left = {name: set(needs) for name, needs in ROOMS.items()}
    while left:
        ready = {name for name, needs in left.items() if not needs & set(left)}
        assert ready, f"these import each other: {sorted(left)}"
        left = {name: needs for name, needs in left.items() if name not in ready}


def imports_at_top(source):
    """Return the dotted names that come with a module's own import."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    at_top = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    return imports_of(ast.Module(at_top, []))


def test_an_optional_library_is_not_imported_with_its_module():
    """`import star_tracker.attachments` works without xlrd: the import stands in a function."""
    assert "xlrd" not in tops_of(imports_at_top(CORE / "attachments.py"))


@pytest.mark.parametrize("command", sorted(ROS_COMMANDS))
def test_nodes_are_not_imported_with_a_command(command):
    """`import star_tracker.cli` works without ROS."""
    assert "nodes" not in rooms_of(imports_at_top(CORE / "commands" / f"{command}.py"))


@named([CORE / "nodes" / f"watch_{name}.py" for name in ("model", "outputs", "record", "view")])
def test_what_watch_makes_of_plain_values_needs_no_ros(source):
    assert not tops_of(imports(source)) & ROS
