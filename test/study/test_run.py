"""A study's chunks: the same results however they are run, stored and resumed."""

import json
import shutil
from dataclasses import replace

import pytest

from star_tracker.maps.simulation import CAMERAS
from star_tracker.study import chunks, execution
from star_tracker.study.chunks import FramesChunk, key, run
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.plan import plan
from star_tracker.study.quantities import condition_of
from star_tracker.study.store import Store


def without_times(results):
    return {
        chunk: [replace(one, cpu_ms=[]) for one in result] for chunk, result in results.items()
    }


def some_of(small):
    """A chunk in five with its result: of maps and of frames, first blocks and last, of each form.

    What is sent elsewhere and comes back is alike for all.
    """
    return dict(list(small.results.items())[1::5])


def test_two_processes_give_what_one_gives(small, tmp_path):
    expected = some_of(small)
    two = execution.run_all(
        list(expected), Store(tmp_path), execution.local(2), lambda n: None
    )
    assert without_times(two) == without_times(expected)


def test_a_chunk_alone_gives_what_it_gives_among_others(small):
    chunk, expected = list(small.results.items())[-1]
    assert without_times({chunk: chunk.solve()}) == without_times({chunk: expected})


def test_contestants_who_take_turns_give_what_each_gives_alone(small):
    """One of them sees every second frame only, counted over all blocks."""
    own, paper = small.study.contestants
    slow = replace(own, name="slow", every=2)
    study = replace(small.study, maps=(), contestants=(own, paper, slow), interleave=True)
    for chunk in plan(study)[:2]:
        assert chunk.contestants == (own, paper, slow)
        together = chunk.solve()
        for one, found in zip((own, paper), together, strict=False):
            alone = replace(chunk, contestants=(one,)).solve()
            assert without_times({chunk: alone}) == without_times({chunk: [found]})
        seen = [number for number in range(chunk.n) if (chunk.first + number) % 2 == 0]
        assert together[2].outcomes == [together[0].outcomes[number] for number in seen]


def test_contestants_see_the_same_frames_and_blocks_others(small):
    frames = [chunk for chunk in plan(small.study) if isinstance(chunk, FramesChunk)]
    states = {
        chunk: tuple(chunk.seed_sequence().generate_state(4).tolist()) for chunk in frames
    }
    for chunk, state in states.items():
        same = {other for other in frames if states[other] == state}
        assert same == {replace(chunk, contestants=(one,)) for one in small.study.contestants}
        assert replace(chunk, seed=8).seed_sequence().generate_state(4).tolist() != list(state)


@pytest.mark.slow
def test_a_dask_cluster_gives_what_this_process_gives(small, tmp_path):
    distributed = pytest.importorskip("distributed")
    expected = some_of(small)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        scheduler_port=0,
    ) as cluster:
        execute = execution.on_cluster(cluster.scheduler_address)
        found = execution.run_all(list(expected), Store(tmp_path), execute, lambda n: None)
    assert without_times(found) == without_times(expected)
    assert len(list(tmp_path.iterdir())) == len(expected)


def test_a_worker_with_other_sources_is_refused(small):
    with pytest.raises(ValueError, match="install the same one everywhere"):
        run(next(iter(small.results)), "other sources")


def damage(path, how):
    content = json.loads(path.read_text(encoding="utf-8"))
    if how == "deleted":
        path.unlink()
        return
    if how == "short":
        content["result"][0]["cpu_ms"].pop()
    elif how == "another":
        content["chunk"]["seed"] = 99
    elif how == "nobody":
        content["result"] = []
    text = json.dumps(content)
    cut = {"truncated": len(text) // 2, "empty": 0}.get(how)
    path.write_text(text[:cut], encoding="utf-8")


def test_only_what_is_missing_or_damaged_is_run_again(small, tmp_path):
    shutil.copytree(small.folder, tmp_path, dirs_exist_ok=True)
    planned = plan(small.study)
    hows = "deleted", "truncated", "empty", "short", "another", "nobody"
    broken = dict(zip(planned[-len(hows):], hows, strict=True))
    for chunk, how in broken.items():
        damage(tmp_path / f"{key(chunk)}.json", how)
    store = Store(tmp_path)
    assert [store.load(chunk) for chunk in broken] == [None] * len(broken)
    assert store.damaged == [f"{key(c)}.json" for c, how in broken.items() if how != "deleted"]
    ran = []
    found = small.run_here(planned, tmp_path, ran)
    assert ran == list(broken)
    assert without_times(found) == without_times(small.results)
    ran.clear()
    assert small.run_here(planned, tmp_path, ran) == found
    assert ran == []


def test_files_are_written_whole(small):
    assert {path.suffix for path in small.folder.iterdir()} == {".json"}
    assert len(list(small.folder.iterdir())) == len(small.results)


def test_the_key_tells_all_that_a_result_depends_on(small, monkeypatch):
    chunk = plan(small.study)[-1]
    others = (
        chunk, replace(chunk, seed=8), replace(chunk, n=9), replace(chunk, block=5),
        replace(chunk, deadline_ms=5.0), replace(chunk, camera=CAMERAS["20 deg"]),
        replace(chunk, contestants=(OwnMethod(),)), replace(chunk, limit_deg=1.0),
        replace(chunk, contestants=(OwnMethod(method="match_group"),)),
        replace(chunk, condition=condition_of({"noise_px": 3.0})),
    )
    keys = {key(one) for one in others}
    monkeypatch.setattr(chunks, "package_version", lambda: "9.9.9")
    assert len(keys | {key(chunk)}) == 11
    monkeypatch.setattr(chunks, "measuring_sources", lambda: "other")
    assert key(chunk) not in keys


@pytest.mark.parametrize("place", ["file", "file/folder"])
def test_a_folder_that_cannot_be_made_is_told(tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="choose another --output"):
        Store(tmp_path / place)
