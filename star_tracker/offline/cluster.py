"""The connection to an existing Dask cluster."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_S = 10
_SCHEMES = ("tcp", "tls")


def connected(address: str) -> "Client":
    """Connect to a Dask scheduler. Raises ValueError where that is not possible."""
    try:
        from distributed import Client  # noqa: PLC0415  only for this
    except ModuleNotFoundError as error:
        raise ValueError(
            f"--scheduler needs {error.name}: apt install python3-distributed, or pip install "
            "distributed"
        ) from error
    try:
        _knock(address)
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except OSError as error:
        raise ValueError(
            f"no Dask scheduler answers at {address}: start `dask scheduler` there and "
            f"`dask worker {address}`, or check the address ({error})"
        ) from error


@contextmanager
def failing_in_words(address: str, afterwards: str = "") -> Iterator[None]:
    """Raise ValueError for what a connected cluster fails with; `afterwards` ends the sentence."""
    import distributed  # noqa: PLC0415  it is there

    try:
        yield
    except (
        ImportError, OSError, distributed.KilledWorker, distributed.client.FutureCancelledError,
    ) as error:
        raise ValueError(
            f"the Dask cluster at {address} failed: {error}; see that star_tracker is installed "
            f"on each worker and start again{afterwards}"
        ) from error


def _knock(address: str) -> None:
    """See that something listens at an address: Dask itself would try for a long time.

    Raises OSError where nothing does, ValueError for what is no address.
    """
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if parts.scheme not in _SCHEMES or not host or not port:
        raise ValueError(
            f"--scheduler {address!r} is no address: give one such as tcp://host:8786"
        )
    socket.create_connection((host, port), _CONNECT_S).close()
