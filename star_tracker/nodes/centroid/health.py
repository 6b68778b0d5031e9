"""How well centroid_node does: what its images are like, and rolling statistics of them."""

from collections import Counter, deque

from star_tracker.detection.centroids import Flag
from star_tracker.nodes.centroid.detector import Detection
from star_tracker.nodes.identify.health import WINDOW_S, quantile

_MOST_IMAGES = 10_000
#: Above this share of dropped images the node warns.
_DROPPED_RATIO = 0.1


class ImageHealth:
    """Counts images and keeps those of the last seconds.

    Times are seconds of a clock that never goes back, as `time.monotonic`.

    Args:
        started_s: when the node began to listen.

    Attributes:
        refused: images of no use, by reason.
        n_dropped: images that were published but never looked at, as newer ones took their place.
    """

    def __init__(self, started_s: float) -> None:
        self._started_s = started_s
        #: When each of the last images was published, its latency, s, and whether it was of use.
        self._images: deque[tuple[float, float, bool]] = deque(maxlen=_MOST_IMAGES)
        self._drops: deque[tuple[float, int]] = deque([(started_s, 0)])
        self._last: Detection | None = None
        self._last_reason = ""
        self.refused: Counter[str] = Counter()
        self.n_images = self.n_dropped = 0

    def add(self, detection: Detection, now_s: float) -> None:
        """Take in what became of an image."""
        self.n_images += 1
        self._images.append((now_s, now_s - detection.image.received_s, not detection.kind))
        if detection.kind:
            self.refused[detection.kind] += 1
            self._last_reason = detection.trouble
        else:
            self._last = detection

    def report(self, now_s: float) -> tuple[str, str, dict[str, object]]:
        """Return level (`ok`, `warn`, `error`), a sentence and values by key."""
        since_s = max(now_s - WINDOW_S, self._started_s)
        while self._images and self._images[0][0] < since_s:
            self._images.popleft()
        latency_ms = sorted(1e3 * latency_s for _, latency_s, _ in self._images)
        values: dict[str, object] = {
            **self._of_the_last_image(),
            "images_per_s": len(self._images) / max(now_s - since_s, 1.0),
            "latency_p50_ms": quantile(latency_ms, 0.50),
            "latency_p95_ms": quantile(latency_ms, 0.95),
            "latency_max_ms": quantile(latency_ms, 1.0),
            "images": self.n_images,
            "dropped": self.n_dropped,
            "refused": self.refused.total(),
            **{f"refused_{kind}": count for kind, count in sorted(self.refused.items())},
            "last_reason": self._last_reason or None,
        }
        return *self._verdict(self._dropped(now_s)), values

    def _of_the_last_image(self) -> dict[str, object]:
        """Return what the last image of use is like."""
        names = (
            "stars", "saturated_stars", "background", "noise", "saturation_level", "psf_sigma_px",
            "streak_px",
        )
        if self._last is None or self._last.stars is None:
            return dict.fromkeys(names)
        stars = self._last.stars
        quality = stars.quality
        dx, dy = quality.streak_px
        return dict(zip(names, (
            len(stars), int(stars.flagged(Flag.SATURATED).sum()), quality.background,
            quality.noise, quality.saturation_level, quality.psf_sigma_px, f"{dx:.1f} {dy:.1f}",
        ), strict=True))

    def _dropped(self, now_s: float) -> int:
        """Return how many images were dropped in the window."""
        self._drops.append((now_s, self.n_dropped))
        while len(self._drops) > 1 and self._drops[1][0] <= now_s - WINDOW_S:
            self._drops.popleft()
        return self.n_dropped - self._drops[0][1]

    def _verdict(self, dropped: int) -> tuple[str, str]:
        n, n_good = len(self._images), sum(good for *_, good in self._images)
        if n == 0:
            return "warn", f"no image in the last {WINDOW_S:g} s"
        if n_good == 0:
            return "error", f"none of {n} images is of use, the last: {self._last_reason}"
        if n_good < n:
            return "warn", f"{n - n_good} of {n} images are of no use: {self._last_reason}"
        if dropped > _DROPPED_RATIO * (dropped + n):
            return "warn", f"{dropped} of {dropped + n} images were dropped for newer ones"
        stars = self._last.stars if self._last is not None else None
        return "ok", f"{0 if stars is None else len(stars)} stars in the last of {n} images"
