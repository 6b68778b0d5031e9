"""Where compiled code is kept, and that it works without any place for it."""

import os
from pathlib import Path

import numpy as np
import pytest
from numba.core import config as numba_config
from processes import completed, environment

from star_tracker import compiled as module
from star_tracker import resources
from star_tracker.compiled import compiled, first_not_below, inlined, machine_code, prefetch

#: One function of the package, as small as there is one.
SMALLEST = """
import numpy as np
from star_tracker.compiled import first_not_below
print(first_not_below(np.array([1.0, 2.0, 4.0]), 0, 3, 3.0))
"""


@pytest.fixture(autouse=True)
def forgotten_folder():
    """The folder is looked for again by this test, and by whatever comes after it."""
    module._cache_folder.cache_clear()
    yield
    module._cache_folder.cache_clear()
    resources.sources_digest.cache_clear()


@pytest.fixture
def no_folders(monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)


# The folder


@pytest.mark.parametrize("name", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
@pytest.mark.usefixtures("no_folders")
def test_the_folder_is_made_where_the_environment_says(name, monkeypatch, tmp_path):
    monkeypatch.setenv(name, str(tmp_path / "not" / "yet"))
    folder = module._cache_folder()
    assert folder.parent == tmp_path / "not" / "yet" / "star_tracker"
    assert folder.name.startswith("compiled-")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []  # what was written to try it is gone


def test_numbas_own_variable_comes_first(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert module._cache_folder().is_relative_to(tmp_path / "numba")
    assert not (tmp_path / "xdg").exists()


@pytest.mark.usefixtures("no_folders")
def test_the_folder_is_in_the_homes_cache_else(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert module._cache_folder().is_relative_to(tmp_path / ".cache" / "star_tracker")


@pytest.mark.usefixtures("no_folders")
def test_an_empty_variable_is_as_good_as_none(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert module._cache_folder().is_relative_to(tmp_path)


def test_a_user_without_a_home_has_no_folder(no_folders, monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    assert module._cache_folder() is None


def test_a_file_in_the_folders_place_is_no_folder(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert module._cache_folder() is None


def test_a_full_disk_is_no_folder(monkeypatch, tmp_path):
    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(Path, "write_bytes", full)
    assert module._cache_folder() is None


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_none(monkeypatch, tmp_path):
    tmp_path.chmod(0o500)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert module._cache_folder() is None


def test_the_folder_follows_the_sources(monkeypatch, tmp_path):
    """A change of a file that is compiled, or one more, is another folder; undone it is the same.

    Machine code of a function contains that of functions of other files which it calls.
    """
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    package = tmp_path / "package"
    package.mkdir()
    (package / "compiled.py").touch()
    other = package / resources.COMPILED_ROOMS[0] / "other.py"
    other.parent.mkdir()
    monkeypatch.setattr(resources, "__file__", str(package / "resources.py"))

    def name():
        resources.sources_digest.cache_clear()
        module._cache_folder.cache_clear()
        return module._cache_folder().name

    alone = name()
    other.write_text("STEP = 1\n")
    first = name()
    other.write_text("STEP = 2\n")
    second = name()
    assert len({alone, first, second}) == 3
    other.write_text("STEP = 1\n")
    assert name() == first
    (other.parent / "notes.txt").write_text("not a source")
    assert name() == first
    assert len(list((tmp_path / "cache" / "star_tracker").iterdir())) == 3


# What is in the folder


def full(self, data):
    raise OSError(30, "Read-only file system")


def test_a_folder_is_warm_once_all_has_been_compiled(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = module._cache_folder()
    assert module.cache_state() == module.CacheState(folder, writable=True, warm=False)
    module.mark_warm()
    assert module.cache_state() == module.CacheState(folder, writable=True, warm=True)


@pytest.mark.parametrize("other", ["__version__", "get_host_cpu_name"])
def test_what_another_numba_or_processor_has_compiled_is_not_warm(other, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    module.mark_warm()
    if other == "__version__":
        monkeypatch.setattr(module.numba, "__version__", "0.0")
    else:
        monkeypatch.setattr(module, "get_host_cpu_name", lambda: "another")
    assert not module.cache_state().warm


def test_a_user_without_a_home_has_nothing_warm(no_folders, monkeypatch):
    monkeypatch.setattr(module, "cache_folder", lambda: None)
    assert module.cache_state() == module.CacheState(None, writable=False, warm=False)
    module.mark_warm()  # does nothing, and nothing is raised


def test_a_read_only_folder_is_used_where_it_is_warm(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert compiled(half_of)(3.0) == 1.5
    module.mark_warm()
    named = module._cache_folder()
    module._cache_folder.cache_clear()
    monkeypatch.setattr(Path, "write_bytes", full)
    assert module._cache_folder() != named
    again = compiled(half_of)
    assert again(3.0) == 1.5
    assert sum(again.stats.cache_hits.values()) == 1
    assert module.cache_state() == module.CacheState(named, writable=False, warm=True)


def test_a_read_only_folder_that_is_not_warm_is_none(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(Path, "write_bytes", full)
    assert module._cache_folder() is None
    assert not module.cache_state().writable


# Compiling


def half_of(x):
    return x / 2


def test_compiled_code_is_kept_in_the_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    function = compiled(half_of)
    assert function(3.0) == 1.5
    kept = [path.suffix for path in module._cache_folder().rglob("*.nb?")]
    assert sorted(kept) == [".nbc", ".nbi"]
    # Another one, as in the next process, compiles nothing.
    again = compiled(half_of)
    assert again(5.0) == 2.5
    assert sum(again.stats.cache_hits.values()) == 1
    assert sum(again.stats.cache_misses.values()) == 0


@pytest.mark.parametrize("decorate", [compiled, inlined])
def test_without_a_folder_it_compiles_all_the_same(decorate, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    function = decorate(half_of)
    assert function(3.0) == 1.5
    assert function.signatures
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_numbas_settings_are_as_before(monkeypatch, tmp_path):
    before = numba_config.CACHE_DIR
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "new"))
    compiled(half_of)
    assert before == numba_config.CACHE_DIR
    with pytest.raises(TypeError):
        compiled("not a function")
    assert before == numba_config.CACHE_DIR


@pytest.mark.parametrize("array", [
    np.arange(5.0), np.arange(6, dtype=np.int32).reshape(2, 3), np.empty((0, 2), np.float32),
])
@pytest.mark.parametrize("at", [0, 4, -1, 2**40, np.int32(3)])
def test_what_is_fetched_ahead_stays_as_it_is(array, at, monkeypatch, tmp_path):
    """Wherever it is: no place is out of bounds."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def fetch(array, at):
        prefetch(array, at)
        return array.size

    before, function = array.copy(), compiled(fetch)
    assert function(array, at) == array.size
    np.testing.assert_array_equal(array, before)
    code = "".join(function.inspect_asm().values())
    assert "prefetch" in code or "prfm" in code  # x86-64, ARM


def test_a_division_by_zero_is_no_exception(monkeypatch, tmp_path):
    """As in numpy: infinity or NaN."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def ratio(a, b):
        return a / b

    function = compiled(ratio)
    assert function(1.0, 0.0) == np.inf
    assert np.isnan(function(0.0, 0.0))


def run(cache):
    return completed(
        "-W", "error", "-c", SMALLEST, env=environment(NUMBA_CACHE_DIR=str(cache))
    )


def test_a_process_keeps_what_it_compiles(tmp_path):
    found = run(tmp_path)
    assert (found.stdout, found.stderr, found.returncode) == ("2\n", "", 0)
    (folder,) = (tmp_path / "star_tracker").iterdir()
    kept = {path.name: path.stat().st_mtime_ns for path in folder.rglob("*.nb?")}
    assert len(kept) == 2
    assert all("first_not_below" in name for name in kept)
    # The next process finds it there and writes nothing.
    again = run(tmp_path)
    assert (again.stdout, again.stderr) == ("2\n", "")
    assert {path.name: path.stat().st_mtime_ns for path in folder.rglob("*.nb?")} == kept


def test_a_process_without_a_place_for_it_works(tmp_path):
    (tmp_path / "file").write_text("in the way")
    found = run(tmp_path / "file")
    assert (found.stdout, found.stderr, found.returncode) == ("2\n", "", 0)


# The search that all tables use


@pytest.mark.parametrize("n", [0, 1, 2, 7, 100])
def test_the_first_value_not_below_is_where_numpy_finds_it(n):
    rng = np.random.default_rng(n)
    values = np.sort(rng.integers(0, 30, n) / 8.0)
    for low in [-1.0, 0.0, 5.0, *rng.uniform(0, 4, 50), *values.tolist()]:
        assert first_not_below(values, 0, n, low) == np.searchsorted(values, low)
        begin, end = n // 4, n - n // 5
        expected = begin + np.searchsorted(values[begin:end], low)
        assert first_not_below(values, begin, end, low) == expected


def test_machine_code_is_that_of_the_function_and_made_once():
    values = np.array([1.0, 2.0, 3.0])
    code = machine_code(first_not_below, values, 0, 3, 2.0)
    n_made = len(first_not_below.overloads)
    assert [code(values, 0, 3, low) for low in (0.5, 2.0, 9.0)] == [0, 1, 3]
    assert code is machine_code(first_not_below, values, 0, 3, 2.0)
    assert len(first_not_below.overloads) == n_made
    with pytest.raises(TypeError):  # an array of another kind is not read as if it were one
        code(values.astype(np.float32), 0, 3, 2.0)
