"""How long tests wait: until what they expect happens.

A limit is only the last resort against a test that hangs. No test fails because a machine is slow
or has other work to do.
"""

import os
import threading
from contextlib import contextmanager

#: Ten times what anything takes on a machine with nothing else to do.
_USUAL_S = 60.0
_BUSY_FACTOR = 5


def longest_s():
    """Return the longest wait for anything, s; longer where the machine is busy just now."""
    busy = os.getloadavg()[0] > (os.cpu_count() or 1)
    return _USUAL_S * (_BUSY_FACTOR if busy else 1)


@contextmanager
def last_resort(end):
    """Call `end()`, which ends what the block waits for, should that hang."""
    timer = threading.Timer(longest_s(), end)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
