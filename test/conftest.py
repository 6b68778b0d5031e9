"""The environment of all tests, set before anything imports ROS.

The tests of the core need no ROS. Those of the rim are skipped where rclpy cannot be imported, but
fail there in continuous integration (environment variable CI), lest they be forgotten.
"""

import os
import warnings
from fnmatch import fnmatch

import pytest

os.environ.update(
    OPENBLAS_NUM_THREADS="1",
    RCUTILS_COLORIZED_OUTPUT="0",
    ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    # A domain of this test run's own: neither robots nor other test runs hear it.
    ROS_DOMAIN_ID=str(1 + os.getpid() % 101),
    ROS_PYTHON_CHECK_FIELDS="1",
)

ROS_TEST_MODULES = (
    "test_adapters_*.py", "test_parameters.py", "test_identify_node.py", "test_replay_node.py",
    "test_processes.py", "test_focal_length_node.py", "test_node_*.py", "test_faults_*.py",
    "test_tutorial.py", "test_watch.py", "test_layouts.py",
)

try:
    # Imported here once, as ROS's own imports warn and in the tests each warning is an error.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import rclpy  # noqa: F401
        import rosidl_generator_py  # noqa: F401
except ImportError as error:
    ROS_MISSING = f"needs ROS 2 Jazzy, but rclpy cannot be imported: {error}"
else:
    ROS_MISSING = ""


class ModuleWithoutRos(pytest.Module):
    """A test module that needs ROS, where there is none."""

    def collect(self):
        if os.environ.get("CI"):
            raise self.CollectError(ROS_MISSING)
        pytest.skip(ROS_MISSING, allow_module_level=True)


def pytest_pycollect_makemodule(module_path, parent):
    if ROS_MISSING and any(fnmatch(module_path.name, name) for name in ROS_TEST_MODULES):
        return ModuleWithoutRos.from_parent(parent, path=module_path)
    return None


@pytest.fixture(scope="session", autouse=True)
def solver_compiled():
    """Compile the solver, or load it: the processes that tests start then find it in its cache."""
    from star_tracker.catalogue.catalog import StarCatalog
    from star_tracker.catalogue.database import FeatureDatabase
    from star_tracker.maps.simulation import CAMERAS
    from star_tracker.tracker import StarTracker

    StarTracker(FeatureDatabase.build(StarCatalog.paper()), CAMERAS["12 deg"])
