"""The contestants: both methods, each as this package and as the paper has it (5.4)."""

from dataclasses import dataclass
from typing import Any

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.fallback import RadialCyclicSettings
from star_tracker.identification.searcher import METHODS
from star_tracker.solution import SolveSettings

FORMS = ("own", "paper")
#: What follows the way to the candidates, alignment, pose and verification, is alike in all forms.
_PAPER: dict[str, Any] = {
    "match_group": MatchGroupSettings(
        pair_tolerance_px=(3.0,), cells=3, quick=False, voting="plain"
    ),
    "radial_cyclic": RadialCyclicSettings(ring_factors=(1,), similarity="paper"),
}


@dataclass(frozen=True)
class Contestant:
    """A method in one of its forms. Raises ValueError for one that does not exist.

    Attributes:
        method: `match_group`, `radial_cyclic` or `auto`.
        form: `own`, or `paper`: match-group voting by plain flags at a tolerance of 3 px, or
            patterns ranked by the printed f_T.
    """

    method: str
    form: str = "own"

    def __post_init__(self) -> None:
        if self.method not in {*METHODS, "auto"}:
            raise ValueError(f"method {self.method!r} is unknown: use auto, {', '.join(METHODS)}")
        if self.form not in FORMS:
            raise ValueError(f"form {self.form!r} is unknown: use {' or '.join(FORMS)}")
        if self.form == "paper" and self.method == "auto":
            raise ValueError("method auto has no form paper: use form own")

    @property
    def name(self) -> str:
        """What reports call it."""
        return f"{self.method}, paper" if self.form == "paper" else self.method

    def settings(self, deadline_ms: float) -> SolveSettings:
        """Return the settings of its tracker."""
        form = {self.method: _PAPER[self.method]} if self.form == "paper" else {}
        return SolveSettings(method=self.method, deadline_ms=deadline_ms, **form)

    def storage_bytes(self, database: FeatureDatabase) -> int:
        """Return the size of the features that it searches."""
        sizes = {
            "match_group": database.pairs.nbytes,
            "radial_cyclic": database.patterns.packed.nbytes,
        }
        return sum(sizes.values()) if self.method == "auto" else sizes[self.method]
