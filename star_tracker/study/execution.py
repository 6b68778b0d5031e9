"""Where the chunks run: in processes on this machine, or on a Dask cluster."""

import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

import joblib

from star_tracker.offline.cluster import connected, failing_in_words
from star_tracker.study.chunks import Chunk, Outcomes, key, measuring_sources, run
from star_tracker.study.store import Store

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
            # As joblib's own "2 * n_jobs", whose reading warns in old releases on Python 3.12.
            results = joblib.Parallel(
                return_as="generator", batch_size=1, pre_dispatch=2 * n_jobs
            )(
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
        client = connected(address)
        import distributed  # noqa: PLC0415  it is there

        sources = measuring_sources()
        with client:
            futures = {
                client.submit(run, chunk, sources, key=f"star_tracker-{key(chunk)}"): place
                for place, chunk in enumerate(chunks)
            }
            try:
                with failing_in_words(address, ": what is done is kept"):
                    for future, result in distributed.as_completed(
                        futures, loop=client.loop, with_results=True
                    ):
                        yield futures[future], result
            finally:
                client.cancel(list(futures))

    return execute


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
