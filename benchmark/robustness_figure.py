"""The curves of the robustness report as one picture.

`python benchmark/robustness_figure.py [results.csv]` draws docs/robustness.png from what
`star_tracker evaluate --output benchmark/results` found.
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from star_tracker.study.figures import write_overview
from star_tracker.study.records import read_csv


def main() -> int:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "results", type=Path, nargs="?", default=ROOT / "benchmark" / "results" / "results.csv"
    )
    write_overview(read_csv(parser.parse_args().results), ROOT / "docs" / "robustness.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
