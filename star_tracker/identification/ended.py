"""How a step on the way of a frame ended."""

from enum import IntEnum


class Ended(IntEnum):
    """How a step ended, in compiled code and around it.

    Attributes:
        MORE: the work or the time for it is spent; there is more to search.
        EXHAUSTED: nothing is left to search.
        CERTAIN: the best pose is certain, but for its mirror image where that fits as well.
        SOLVED: the frame is labelled.
        TOO_FEW: fewer than `MIN_STARS` usable centroids.
        NO_ROTATION: the predicted pose is no rotation.
        AMBIGUOUS: the best pose is good enough, and so is another.
        FAR: the frame is labelled, but its stars lie far from their places, and carry so little
            that another focal length than the told one may fit far better.
        CONTRADICTED: the best pose is good enough, and yet the camera is another one: most of the
            stars that make it so are gone once it is fitted to them, or they contradict the told
            focal length and are far off with any, or are far off and carry too little, or are
            dozens of pixels off.
    """

    MORE = 0
    EXHAUSTED = 1
    CERTAIN = 2
    SOLVED = 3
    TOO_FEW = 4
    NO_ROTATION = 5
    AMBIGUOUS = 6
    FAR = 7
    CONTRADICTED = 8


#: Fewer stars than this fit some guide stars by chance too often to be told apart from truth.
MIN_STARS = 4
#: Where the focal length is one more unknown, one more star is needed.
MIN_STARS_OF_A_SCALE = 5
