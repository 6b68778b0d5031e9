"""Records, tables, curves and the pages that are made of them."""

import csv
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from star_tracker.commands import evaluate
from star_tracker.study import report
from star_tracker.study.chunks import IDENTIFIED, FramesChunk, Outcomes
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.plan import MAP, places
from star_tracker.study.records import summarise, wilson
from star_tracker.study.tables import markdown_tables, three_digits


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    # From the closed form; 0 of n ends at z^2 / (n + z^2).
    [(0, 10, 0.0, 0.27753), (5, 10, 0.23659, 0.76341), (10, 10, 0.72247, 1.0),
     (1, 100, 0.00177, 0.05449)],
)
def test_wilson_interval(k, n, low, high):
    assert wilson(k, n) == pytest.approx((low, high), abs=1e-5)


def test_every_contestant_meets_every_condition_on_every_camera(small):
    met = {(r.camera, r.condition, r.contestant) for r in small.records}
    assert met == {
        (place.camera, place.condition.words, one.title)
        for place in places(small.study) for one in small.study.contestants
    }
    assert len(small.records) == len(met)


def test_the_rates_of_a_record_are_those_of_its_chunks(small):
    for record in small.records:
        outcomes = [
            outcome for chunk, result in small.results.items()
            for one, found in zip(chunk.contestants, result, strict=True)
            if (*chunk.place, one.title) == (record.camera, record.condition, record.contestant)
            for outcome in found.outcomes
        ]
        assert record.n == len(outcomes) == (record.n if record.sweep == MAP else 3)
        right = outcomes.count(IDENTIFIED)
        assert record.identified_percent == pytest.approx(100 * right / record.n)
        total = record.identified_percent + record.wrong_percent + record.unanswered_percent
        assert total == pytest.approx(100)
        assert record.identified_low_percent <= record.identified_percent
        assert record.identified_percent <= record.identified_high_percent
        assert 0 < record.median_cpu_ms <= record.p95_cpu_ms
        assert (record.bound_percent is None) == (record.sweep == MAP)


def by_hand(small):
    """A condition of one camera seen by two contestants, one of them every second frame."""
    fast, slow = OwnMethod("us", method="auto"), OwnMethod("them", every=2)
    study = replace(
        small.study, contestants=(fast, slow), cameras=small.study.cameras[:1], maps=(),
        sweeps=(), combined=("m40",), frames=4,
    )
    place = next(places(study))
    chunk = FramesChunk(
        (fast, slow), "12 deg", study.cameras[0][1], place.condition, 0, 0, 4, 0, 1.0, 0.1
    )
    result = [
        Outcomes(
            2_000_000, [IDENTIFIED, "WRONG", IDENTIFIED, IDENTIFIED], [0.001, 2.0, 0.003, 0.002],
            [1.0, 50.0, 3.0, 60.0], [4, 3, 7, 9], [1.0, 1e3, 9.3, 2.0],
        ),
        Outcomes(None, [IDENTIFIED, "TIMEOUT"], [0.001, None], [0.01, 0.03], [4, 7]),
    ]
    return study, summarise(study, {chunk: result})


def test_a_record_by_hand(small):
    study, (us, them) = by_hand(small)
    assert us.median_error_arcsec == pytest.approx(0.002 * 3600)
    assert (us.bound_percent, us.n, us.n_timeout, us.time_ratio) == (75.0, 4, 0, 1.0)
    assert (them.n, them.n_timeout, them.storage_bytes) == (2, 1, None)
    assert (us.beyond_bound_percent, us.n_wrong_beyond) == (50.0, 1)
    assert (them.beyond_bound_percent, them.n_wrong_beyond) == (None, None)
    # Our median on the two frames that they have seen: 2 ms against 0.02 ms.
    assert them.time_ratio == pytest.approx(100)
    us_, them_ = report.balances(study, [us, them])
    assert (us_.n_frames, us_.n_wrong, us_.n_timeout, us_.maps_right) == (4, 1, 0, "")
    assert (them_.n_frames, them_.n_timeout, them_.storage_bytes) == (2, 1, None)


def test_the_tables_as_markdown(small):
    lines = "\n".join(markdown_tables(*by_hand(small))).splitlines()
    assert lines[0] == "## 12 deg"
    assert "| condition | bound | us<br>4 frames | them<br>2 frames |" in lines
    assert (
        "| m40 | 75.0 | 75.0 / 25.0 / 26.5 / 58.5 | 50.0 / 0.0 / 0.0200 / 0.0290 |" in lines
    )
    assert "| m40 | 100 |" in lines
    assert lines[-3:] == ["| condition | us |", "| --- | ---: |", "| m40 | 50.0 / 1 of 1 |"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.03811, "0.0381"), (9.996, "10.00"), (1.5, "1.50"), (207.4, "207"),
     (1004.3, "1004")],
)
def test_numbers_have_three_digits_at_most_after_the_point(value, text):
    assert three_digits(value) == text


@pytest.fixture(scope="module")
def written(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    report.write_report(small.study, small.records, ["a note"], folder)
    return folder


def test_the_files_of_a_report(small, written):
    assert sorted(path.name for path in written.iterdir()) == [
        "curves.png", "report.html", "report.md", "results.csv"
    ]
    rows = list(csv.DictReader((written / "results.csv").read_text("utf-8").splitlines()))
    assert [
        {k: "" if v is None else str(v) for k, v in vars(r).items()} for r in small.records
    ] == rows
    picture = (written / "curves.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 200_000


def test_the_markdown_page_names_contestants_notes_versions_and_seed(small, written):
    text = (written / "report.md").read_text(encoding="utf-8")
    assert text.startswith("# Robustness of star identification\n")
    assert "- **match_group, paper**: method match_group as the paper has it, in numpy" in text
    assert "- a note." in text
    assert f"numpy {np.__version__}" in text
    assert "seed 7" in text
    assert "or within 4 standard deviations" in text
    assert "## maps" in text


@pytest.mark.parametrize("name", ["results.csv", "report.html", "curves.png"])
def test_a_file_that_cannot_be_written_is_told(small, tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ValueError, match=f"{name} cannot be written: Is a directory"):
        report.write_report(*by_hand(small), [], tmp_path)


def test_the_balance_counts_maps_and_frames_once(small):
    own, paper = report.balances(small.study, small.records)
    assert (own.maps_right, own.maps_lost) == ("2 of 2", "none")
    assert (paper.maps_right, paper.maps_lost) == ("1 of 2", "3")
    assert own.n_frames == 3 * 5 * len(small.study.cameras)


def test_the_tables_go_into_80_columns(small):
    from rich.console import Console

    console = Console(width=200, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    with console.file:
        for table in evaluate._tables(small.study, small.records):
            console.print(table)
    lines = console.export_text().splitlines()
    assert max(len(line.rstrip()) for line in lines if "wrong but" not in line) <= 80
    assert sum(line.startswith("map ") for line in lines) == 2
    assert sum(line.startswith("features") for line in lines) == 3


# ---- the page in a browser -------------------------------------------------------------------


def chromium(playwright):
    """Return the path of a Chromium, or skip."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    found = next((path for path in map(shutil.which, names) if path), None)
    own = Path(playwright.chromium.executable_path)
    if found is None and not own.exists():
        pytest.skip("no Chromium: requirements/browser.sh installs one")
    return found or str(own)


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=chromium(playwright),
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        yield started
        started.close()


@pytest.mark.parametrize("width_px", [1280, 400])
def test_the_page_in_a_browser(written, browser, small, width_px):
    page = browser.new_page(viewport={"width": width_px, "height": 900})
    trouble = []
    page.on("console", lambda message: trouble.append(message.text))
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("requestfailed", lambda request: trouble.append(request.url))
    page.goto((written / "report.html").as_uri())
    assert trouble == []
    pictures = page.eval_on_selector_all(
        "figure img", "all => all.map(i => [i.naturalWidth, i.clientWidth, i.clientHeight, i.alt])"
    )
    assert len(pictures) == (len(small.study.sweeps) + 1) * len(small.study.cameras)
    for natural, width, height, words in pictures:
        assert min(natural, width, height) > 200
        assert "match_group, paper identifies (%)" in words
    # Also where all tables are open, only they scroll.
    page.eval_on_selector_all("details", "all => all.forEach(d => { d.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width_px
    assert page.locator("table").count() == 1 + len(small.study.sweeps) + 2
    page.close()


def test_the_page_needs_nothing_else(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_the_page_escapes_what_the_user_wrote(small):
    name = "<b>wide</b>"
    few = [r for r in small.records if r.sweep in (MAP, "noise_px")]  # each other is two pictures
    renamed = [replace(r, camera=name) if r.camera == "wide" else r for r in few]
    text = report.html_page(replace(small.study, title="a < b"), renamed, ["<note>"])
    for escaped in ("&lt;b&gt;wide&lt;/b&gt;", "a &lt; b", "&lt;note&gt;"):
        assert escaped in text
    assert name not in text
