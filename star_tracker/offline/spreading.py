"""Work on many things, in processes or on a Dask cluster: results in order, little in memory."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from star_tracker.offline.cluster import connected, failing_in_words
from star_tracker.resources import sources_digest

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")

#: So many things for each process are under way or wait, so that none stands idle.
_AHEAD = 3
#: The sources that a detection depends on, beside those that are compiled.
_SOURCES = ("offline/frame_file.py", "offline/image_file.py", "offline/solving.py")


@dataclass(frozen=True)
class Spread:
    """Where work is done.

    Attributes:
        jobs: processes of this machine; 1 = this one.
        scheduler: address of a Dask scheduler, empty for none.

    Raises ValueError for fewer jobs than one.
    """

    jobs: int = os.cpu_count() or 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ValueError("--jobs must be at least 1")

    def map(self, work: Callable[[_Item], _Made], items: Iterable[_Item]) -> Iterator[_Made]:
        """Yield what becomes of items, in their order; a few are taken ahead.

        Raises what `work` raises, and ValueError where a cluster fails.
        """
        if self.scheduler:
            yield from _on_cluster(self.scheduler, work, items)
        elif self.jobs == 1:
            yield from map(work, items)
        else:
            with ProcessPoolExecutor(max_workers=self.jobs) as pool:

                def submit(item: _Item) -> Any:
                    return pool.submit(work, item)

                yield from _in_order(submit, items, _AHEAD * self.jobs)


def _on_cluster(
    address: str, work: Callable[[_Item], _Made], items: Iterable[_Item]
) -> Iterator[_Made]:
    client = connected(address)
    digest = sources_digest(*_SOURCES)
    with client:

        def submit(item: _Item) -> Any:
            # Images are sent as data: as arguments they would go through the scheduler.
            return client.submit(
                _checked, work, client.scatter(item, hash=False), digest, pure=False
            )

        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        ahead = _AHEAD * max(1, sum(worker["nthreads"] for worker in workers))
        with failing_in_words(address):
            yield from _in_order(submit, items, ahead)


def _checked(work: Callable[[_Item], _Made], item: _Item, digest: str) -> _Made:
    """Work where the sources are those of who asked, so that the results are the same."""
    if sources_digest(*_SOURCES) != digest:
        raise ValueError(
            "a Dask worker has another version of star_tracker: install the same on each worker"
        )
    return work(item)


def _in_order(
    submit: Callable[[_Item], Any], items: Iterable[_Item], ahead: int
) -> Iterator[Any]:
    """Yield the results of futures in the items' order; so many are under way at the most."""
    under_way: deque[Any] = deque()
    try:
        for item in items:
            under_way.append(submit(item))
            if len(under_way) >= ahead:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
    finally:
        for future in under_way:
            future.cancel()
