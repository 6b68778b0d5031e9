"""Bags for tests, and what lies in one."""

import math

from rosbags.highlevel import AnyReader

from star_tracker.bags.reading import Wanted, open_bag
from star_tracker.bags.recording import Recording, record_maps
from star_tracker.bags.solving import BagSolver
from star_tracker.bags.writing import new_bag
from star_tracker.maps.star_map import paper_maps
from star_tracker.offline.solving import Asked
from star_tracker.offline.spreading import Spread
from star_tracker.solution import SolveSettings

HERE = Spread(jobs=1)
#: A frame may take as long as a busy machine needs.
PATIENT = SolveSettings(method="match_group", deadline_ms=math.inf)


def asked_for(**told):
    """What a user tells of the camera and the sky, with patience."""
    return Asked(settings=PATIENT, **told)


def maps_bag(path, numbers=(1, 2, 3, 4, 5, 6, 7, 8), storage=None, **recording):
    """Write a bag of maps and return its path."""
    with new_bag(path, storage) as writer:
        record_maps(writer, paper_maps(numbers), Recording(**recording))
    return path


def raw_messages(path):
    """Return topic, type, time of recording and CDR of each message."""
    with AnyReader([path]) as reader:
        return [
            (one.topic, one.msgtype, logged_ns, bytes(raw))
            for one, logged_ns, raw in reader.messages()
        ]


def solved(path, asked=None, spread=HERE, **wanted):
    """Return the results of a bag's frames."""
    with open_bag(path, Wanted(**wanted)) as bag:
        solver = BagSolver(bag, asked or asked_for())
        return [result for _, result in solver.results(spread)]
