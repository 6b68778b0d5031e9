"""The environment of all tests, set before anything imports ROS, and what most of them need.

The tests of the core need numpy, scipy and numba. Those of the rim and of the extras are skipped
where their libraries are missing, but fail there in continuous integration (environment variable
CI), lest they be forgotten.
"""

import errno
import os
import signal
import socket
import warnings
from importlib import import_module
from pathlib import Path

import pytest

HERE = Path(__file__).parent
#: What the tests of a folder need besides; single files say it themselves by importorskip.
NEEDS = {
    "bags": ("rosbags",),
    "earth": ("erfa",),
    "figures": ("matplotlib",),
    "msg_adapters": ("rclpy",),
    "nodes": ("rclpy", "yaml"),
    "study": ("jinja2", "joblib", "matplotlib", "yaml"),
}
#: ROS can use 101 domains on a computer besides the usual one; each has a port as its lock.
_DOMAINS = 101
_FIRST_PORT = 22_119


def claim_domain():
    """Return a ROS domain that no other test run has, and what holds it for this process's life.

    ROS's own domain_coordinator claims them in the same way: by binding a port.
    """
    for n in range(_DOMAINS):
        domain = 1 + (os.getpid() + n) % _DOMAINS
        claim = socket.socket()
        try:
            claim.bind(("127.0.0.1", _FIRST_PORT + domain))
        except OSError as error:
            claim.close()
            if error.errno != errno.EADDRINUSE:
                raise
        else:
            return domain, claim
    raise RuntimeError(f"{_DOMAINS} test runs are at work: wait until one has ended")


ROS_DOMAIN, _CLAIM = claim_domain()
os.environ.update(
    OPENBLAS_NUM_THREADS="1",
    RCUTILS_COLORIZED_OUTPUT="0",
    ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    # Neither robots nor other test runs hear this one, nor do the workers of one run each other.
    ROS_DOMAIN_ID=str(ROS_DOMAIN),
    ROS_PYTHON_CHECK_FIELDS="1",
)

# A shell that runs the tests in the background has them ignore Ctrl-C, and so would the processes
# that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


def fault_of(name):
    """Import a library; return what is wrong with it in words, or nothing."""
    try:
        # Other people's imports may warn, and in the tests each warning is an error.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import_module(name)
    except ImportError as error:
        return f"needs {name}, which cannot be imported: {error}"
    return ""


#: What warns where it is imported first: ROS's messages, and with Ubuntu 24.04's versions
#: dateutil, from within matplotlib. Here once, whichever test is the first to import it.
for warner in ("rosidl_generator_py", "matplotlib.figure"):
    fault_of(warner)


class Module(pytest.Module):
    """A test module that is skipped where a library is missing that its folder needs."""

    def collect(self):
        folder = self.path.relative_to(HERE).parts[0]
        for fault in filter(None, map(fault_of, NEEDS.get(folder, ()))):
            if os.environ.get("CI"):
                raise self.CollectError(fault)
            pytest.skip(fault, allow_module_level=True)
        return super().collect()


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path, parent):
    """Make all modules here, so that a missing library skips the files that need it and no more.

    launch_testing, which comes with ROS, would import each file to look for a launch description:
    what is raised there takes the whole run or the whole folder along.
    """
    return Module.from_parent(parent, path=module_path)


# What is made once for all tests of a run. Imported there: the environment above comes first.


@pytest.fixture(scope="session")
def catalog():
    """The paper's stars."""
    from star_tracker.catalogue.catalog import StarCatalog

    return StarCatalog.paper()


@pytest.fixture(scope="session")
def database(catalog):
    """Features of the paper's stars."""
    from star_tracker.catalogue.database import FeatureDatabase

    return FeatureDatabase.build(catalog)


@pytest.fixture(scope="session")
def trackers(database):
    """Trackers of the paper's stars by camera; they take as long as they need for a frame."""
    from star_tracker.maps.simulation import CAMERAS
    from star_tracker.solution import SolveSettings
    from star_tracker.tracker import StarTracker

    patient = SolveSettings(deadline_ms=float("inf"))
    return {name: StarTracker(database, camera, patient) for name, camera in CAMERAS.items()}


@pytest.fixture(scope="session")
def solver_compiled(trackers):
    """Compile the solver, or load it: the processes that a test starts find it in its cache."""
    from star_tracker.commands.compile import exercise_detector, exercise_solver
    from star_tracker.compiled import mark_warm

    exercise_solver()
    exercise_detector()
    mark_warm()
    return trackers
