"""Where the chunks run: in processes on this machine, or on a Dask cluster."""

import signal
import socket
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import joblib

from star_tracker.study.chunks import Chunk, Outcomes, key, measuring_sources, run
from star_tracker.study.store import Store

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_S = 10
_SCHEMES = ("tcp", "tls")
#: Yields the results of chunks, each with its place among them, in any order.
Execute = Callable[[list[Chunk]], Iterator[tuple[int, list[Outcomes]]]]


def local(jobs: int) -> Execute:
    """Return what runs chunks in `jobs` processes; 1 = in this one, 0 = one for each core.

    Raises ValueError for fewer.
    """
    if jobs < 0:
        raise ValueError("--jobs must be at least 1, or 0 for one for each core")
    n_jobs = jobs or joblib.cpu_count()

    def execute(chunks: list[Chunk]) -> Iterator[tuple[int, list[Outcomes]]]:
        sources = measuring_sources()
        # The kernels are small: threads of BLAS cost more than they give.
        with (
            joblib.parallel_config("loky", n_jobs=n_jobs, inner_max_num_threads=1),
            _interrupts_for_this_process_only(),
        ):
            results = joblib.Parallel(return_as="generator", batch_size=1)(
                joblib.delayed(run)(chunk, sources) for chunk in chunks
            )
        try:
            yield from enumerate(results)
        finally:
            with warnings.catch_warnings():
                # joblib's advice for a run that was ended: the command says what to do.
                warnings.filterwarnings("ignore", r"\d+ tasks? ", UserWarning)
                results.close()

    return execute


@contextmanager
def _interrupts_for_this_process_only() -> Iterator[None]:
    """Let processes that start meanwhile ignore Ctrl-C, which reaches all of a terminal.

    This one ends the others; they inherit that the signal is ignored.
    """
    if current_thread() is not main_thread():  # only there it can be set
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def on_cluster(address: str) -> Execute:
    """Return what runs chunks on the Dask cluster of the scheduler at `address`.

    It raises ValueError where distributed is not installed, no scheduler answers or the cluster
    fails.
    """

    def execute(chunks: list[Chunk]) -> Iterator[tuple[int, list[Outcomes]]]:
        client = _client(address)
        import distributed  # noqa: PLC0415  _client has found it

        sources = measuring_sources()
        with client:
            futures = {
                client.submit(run, chunk, sources, key=f"star_tracker-{key(chunk)}"): place
                for place, chunk in enumerate(chunks)
            }
            try:
                for future, result in distributed.as_completed(
                    futures, loop=client.loop, with_results=True
                ):
                    yield futures[future], result
            except (
                ImportError, OSError, distributed.KilledWorker,
                distributed.client.FutureCancelledError,
            ) as error:
                raise ValueError(
                    f"the Dask cluster at {address} failed: {error}; see that star_tracker is "
                    "installed on each worker and start again: what is done is kept"
                ) from error
            finally:
                client.cancel(list(futures))

    return execute


def _client(address: str) -> "Client":
    """Connect to a Dask scheduler. Raises ValueError where that is not possible."""
    try:
        from distributed import Client  # noqa: PLC0415  only for this
    except ModuleNotFoundError as error:
        raise ValueError(
            f"--scheduler needs {error.name}: pip install 'star_tracker[dask]'"
        ) from error
    try:
        _knock(address)
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except OSError as error:
        raise ValueError(
            f"no Dask scheduler answers at {address}: start `dask scheduler` there and "
            f"`dask worker {address}`, or check the address ({error})"
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


def run_all(
    chunks: list[Chunk], store: Store, execute: Execute, advance: Callable[[int], None]
) -> dict[Chunk, list[Outcomes]]:
    """Return the results of all chunks, of which only those are run that the store lacks.

    `advance` is called with the number of chunks that have come in.
    """
    results = {chunk: result for chunk in chunks if (result := store.load(chunk)) is not None}
    missing = [chunk for chunk in chunks if chunk not in results]
    advance(len(results))
    if missing:
        for place, result in execute(missing):
            store.save(missing[place], result)
            results[missing[place]] = result
            advance(1)
    return results
