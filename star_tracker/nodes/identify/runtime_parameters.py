"""The setup of identify_node: built in a thread, and changed as a whole between two frames."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.commands.compile import exercise_solver
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS

_TABLE = {parameter.name: parameter for parameter in IDENTIFY_PARAMETERS}


class RuntimeParameters:
    """Takes a node from one setup to the next, the first included: all of a change or nothing.

    All but the building happens in the node's executor, so that no frame sees half of a change. A
    setup that needs another database waits for it, and later changes with it; the one before
    serves meanwhile. Where a database cannot be built, the parameters go back to what they were;
    where that is the first one, ParameterError comes out of spin.

    Args:
        node: whose parameters have been declared.
        first: the setup to begin with.
        apply: called with a setup and its database; raises ValueError for a misfit.
    """

    def __init__(
        self, node: Node, first: SolverSetup, apply: Callable[[SolverSetup, FeatureDatabase], None]
    ) -> None:
        self._node, self._apply = node, apply
        self._active: SolverSetup | None = None
        self._database: FeatureDatabase | None = None
        self._wanted = self._building = first
        self._thread: threading.Thread | None = None
        self._built: FeatureDatabase | Exception | None = None
        self._ready = node.create_guard_condition(self._on_built)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take_over)

    def start(self) -> None:
        """Begin to build the first database, when all else of the node stands."""
        self._go()

    @property
    def building(self) -> bool:
        """Whether a database is being built."""
        return self._thread is not None

    def finish(self) -> None:
        """Wait for a database that is being built, before the node goes."""
        if self._thread is not None:
            self._thread.join()

    def _with(self, parameters: Sequence[RosParameter]) -> SolverSetup:
        """Return the wanted setup with changes. Raises ValueError for what cannot be."""
        changes = {
            p.name: _TABLE[p.name].checked(p.value) for p in parameters if p.name in _TABLE
        }
        return SolverSetup.of(replace(self._wanted.parameters, **changes), self._wanted)

    def _check(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        """Refuse what cannot be carried out, as far as a second tells."""
        try:
            setup = self._with(parameters)
            if self._active is not None and setup.database_key == self._active.database_key:
                setup.tracker(self._database)
            elif setup != self._wanted:
                setup.check()
        except ValueError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: Sequence[RosParameter]) -> None:
        setup = self._with(parameters)
        if setup != self._wanted:
            self._wanted = setup
            self._go()

    def _go(self) -> None:
        """Apply what is wanted, or build what it needs first."""
        if self._thread is not None:
            return  # looked at again when that is done
        if self._active is not None:
            if self._wanted.database_key == self._active.database_key:
                self._swap(self._database)
                return
            self._node.get_logger().info(
                "building another database, the old one serves meanwhile"
            )
        self._building = self._wanted
        self._thread = threading.Thread(target=self._build, args=(self._wanted,), daemon=True)
        self._thread.start()

    def _build(self, setup: SolverSetup) -> None:
        """Build in a thread of its own; a tracker too, which compiles and builds patterns."""
        try:
            if self._active is None:
                exercise_solver()
            database = setup.build_database()
            setup.tracker(database)
            self._built = database
        except Exception as error:  # whatever it is, it is told in the executor
            self._built = error
        self._ready.trigger()

    def _on_built(self) -> None:
        built, self._built = self._built, None
        if self._thread is None or built is None:
            return
        self._thread.join()
        self._thread = None
        if self._building.database_key != self._wanted.database_key:
            self._go()  # something else is wanted by now
        elif isinstance(built, Exception):
            self._go_back(built)
        else:
            self._swap(built)

    def _swap(self, database: FeatureDatabase) -> None:
        try:
            self._apply(self._wanted, database)
        except ValueError as error:
            self._go_back(error)
            return
        self._active, self._database = self._wanted, database

    def _go_back(self, error: Exception) -> None:
        """Say why a change was not possible, and undo it."""
        if self._active is None:
            if isinstance(error, ValueError):
                raise ParameterError(str(error)) from error
            raise error
        text = " ".join(str(error).split())
        self._node.get_logger().error(f"the parameters stay as they were: {text}")
        wanted, self._wanted = asdict(self._wanted.parameters), self._active
        self._node.set_parameters_atomically([
            RosParameter(name, value=list(value) if isinstance(value, tuple) else value)
            for name, value in asdict(self._active.parameters).items() if value != wanted[name]
        ])
