"""Parameters that change while identify_node runs: checked as a whole, applied between frames."""

import threading
from collections.abc import Callable, Sequence

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.nodes.identify.configuration import Configuration
from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS

_TABLE = {parameter.name: parameter for parameter in IDENTIFY_PARAMETERS}


class RuntimeParameters:
    """Takes a node from one configuration to the next, all changes of a call or none of them.

    All but the building happens in the node's executor, so that no frame sees half of a change. A
    change that needs another database waits for it, and later changes with it; the old
    configuration serves meanwhile. Where the database cannot be built, the parameters go back.

    Args:
        node: whose parameters have been declared.
        active: the configuration that it works with now.
        database: the same.
        apply: called with a configuration and its database; raises ValueError for a misfit.
    """

    def __init__(
        self, node: Node, active: Configuration, database: FeatureDatabase,
        apply: Callable[[Configuration, FeatureDatabase], None],
    ) -> None:
        self._node, self._apply = node, apply
        self._active = self._wanted = active
        self._database = database
        self._thread: threading.Thread | None = None
        self._built: FeatureDatabase | Exception | None = None
        self._ready = node.create_guard_condition(self._on_built)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take_over)

    @property
    def building(self) -> bool:
        """Whether a database is being built."""
        return self._thread is not None

    def finish(self) -> None:
        """Wait for a database that is being built, before the node goes."""
        if self._thread is not None:
            self._thread.join()

    def _with(self, parameters: Sequence[RosParameter]) -> Configuration:
        """Return the wanted configuration with changes. Raises ValueError for what cannot be."""
        changes = {
            p.name: _TABLE[p.name].checked(p.value) for p in parameters if p.name in _TABLE
        }
        return Configuration.of({**self._wanted.values, **changes})

    def _check(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            configuration = self._with(parameters)
            if configuration.database_key == self._active.database_key:
                configuration.tracker(self._database)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: Sequence[RosParameter]) -> None:
        configuration = self._with(parameters)
        if configuration == self._wanted:
            return
        self._wanted = configuration
        self._go()

    def _go(self) -> None:
        """Apply what is wanted, or build what it needs first."""
        if self._thread is not None:
            return  # looked at again when that is done
        if self._wanted.database_key == self._active.database_key:
            self._swap(self._database)
            return
        self._node.get_logger().info("building another database, the old one serves meanwhile")
        self._thread = threading.Thread(target=self._build, args=(self._wanted,), daemon=True)
        self._building = self._wanted
        self._thread.start()

    def _build(self, configuration: Configuration) -> None:
        """Build in a thread of its own; a tracker too, which builds the fallback's features."""
        try:
            database = configuration.build_database()
            configuration.tracker(database)
            self._built = database
        except Exception as error:  # whatever it is, the node goes on as it was
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
        text = " ".join(str(error).split())
        self._node.get_logger().error(f"the parameters stay as they were: {text}")
        wanted, self._wanted = self._wanted.values, self._active
        self._node.set_parameters_atomically([
            RosParameter(name, value=list(value) if isinstance(value, tuple) else value)
            for name, value in self._active.values.items() if value != wanted[name]
        ])
