"""The package's data is found in a checkout and below an install prefix."""

import re
from pathlib import Path

import pytest

from star_tracker import resources
from star_tracker.resources import (
    COMPILED_ROOMS,
    cache_folder,
    resource_path,
    sources_digest,
)

SHIPPED = (
    "package.xml", "data/hipparcos_v8.npy", "data/crossid.csv", "data/README.md",
    "data/star_maps/map1.csv",
)


def installed(monkeypatch, module):
    """Pretend that the module was installed as this file."""
    module.parent.mkdir(parents=True)
    module.touch()
    monkeypatch.setattr(resources, "__file__", str(module))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_files_are_found(name):
    assert resource_path(name).is_file()


def test_a_folder_is_found():
    folder = resource_path("data/star_maps")
    assert sorted(p.name for p in folder.glob("map*.csv")) == [f"map{i}.csv" for i in range(1, 9)]


def test_a_missing_resource_says_where_it_was_looked_for(tmp_path, monkeypatch):
    (tmp_path / "checkout").mkdir()
    (tmp_path / "checkout/package.xml").touch()
    installed(monkeypatch, tmp_path / "checkout/star_tracker/resources.py")
    text = (
        f"data/absent.npy of the package star_tracker was not found below "
        f"{(tmp_path / 'checkout').resolve()}: "
        "the installation is incomplete, install the package again"
    )
    with pytest.raises(FileNotFoundError, match=f"^{re.escape(text)}$"):
        resource_path("data/absent.npy")


@pytest.mark.parametrize(
    "site",
    [
        "lib/python3.12/site-packages",  # pip into a venv, colcon
        "local/lib/python3.12/dist-packages",  # pip on Ubuntu
        "Lib/site-packages",  # pip on Windows
    ],
)
def test_data_is_found_below_the_share_of_an_install_prefix(tmp_path, monkeypatch, site):
    data = tmp_path / "share/star_tracker/data/crossid.csv"
    data.parent.mkdir(parents=True)
    data.write_text("number\n")
    installed(monkeypatch, tmp_path / site / "star_tracker/resources.py")
    assert resource_path("data/crossid.csv") == data.resolve()


def test_the_nearest_prefix_comes_first(tmp_path, monkeypatch):
    """A venv that lies inside of another prefix uses its own data."""
    for prefix in (tmp_path, tmp_path / "venv"):
        data = prefix / "share/star_tracker/data/crossid.csv"
        data.parent.mkdir(parents=True)
        data.write_text(str(prefix))
    site = tmp_path / "venv/lib/python3.12/site-packages"
    installed(monkeypatch, site / "star_tracker/resources.py")
    assert resource_path("data/crossid.csv").read_text() == str(tmp_path / "venv")


def test_an_install_without_data_says_so(tmp_path, monkeypatch):
    module = tmp_path / "lib/site-packages/star_tracker/resources.py"
    installed(monkeypatch, module)
    with pytest.raises(FileNotFoundError) as missing:
        resource_path("data/no_such_file.npy")
    assert str(missing.value) == (
        f"data/no_such_file.npy of the package star_tracker was not found below "
        f"{module.parent.resolve()}: the installation is incomplete, install the package again"
    )


def test_a_checkout_comes_before_whatever_is_installed(tmp_path, monkeypatch):
    checkout = tmp_path / "src/star_tracker_checkout"
    installed(monkeypatch, checkout / "star_tracker/resources.py")
    (checkout / "package.xml").touch()
    (checkout / "data").mkdir()
    (checkout / "data/crossid.csv").write_text("checkout")
    share = tmp_path / "share/star_tracker/data"
    share.mkdir(parents=True)
    (share / "crossid.csv").write_text("installed")
    assert resource_path("data/crossid.csv").read_text() == "checkout"


def test_a_link_into_a_checkout_is_followed(tmp_path, monkeypatch):
    """As `colcon build --symlink-install` and editable installs make them."""
    checkout = tmp_path / "src/checkout"
    module = checkout / "star_tracker/resources.py"
    module.parent.mkdir(parents=True)
    module.touch()
    (checkout / "package.xml").touch()
    link = tmp_path / "install/lib/python3.12/site-packages/star_tracker"
    link.parent.mkdir(parents=True)
    link.symlink_to(module.parent, target_is_directory=True)
    monkeypatch.setattr(resources, "__file__", str(link / "resources.py"))
    assert resource_path("package.xml") == checkout.resolve() / "package.xml"


def test_paths_are_absolute_wherever_the_program_was_started(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = resource_path("package.xml")
    assert path.is_absolute()
    assert isinstance(path, Path)


# The cache


def test_the_cache_lies_where_the_user_says(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "star_tracker"
    assert not cache_folder().exists()


@pytest.mark.parametrize("named", [None, ""])
def test_the_cache_lies_in_the_home_otherwise(monkeypatch, tmp_path, named):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if named is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", named)
    assert cache_folder() == tmp_path / ".cache" / "star_tracker"


def test_a_user_without_a_home_has_no_cache(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert cache_folder() is None


@pytest.mark.parametrize("place", ["compiled.py", *(
    f"{room}/deep/module.py" for room in COMPILED_ROOMS
)])
def test_sources_are_named_by_what_they_hold(monkeypatch, tmp_path, place):
    monkeypatch.setattr(resources, "__file__", str(tmp_path / "resources.py"))
    (tmp_path / "compiled.py").touch()
    source = tmp_path / place
    source.parent.mkdir(parents=True, exist_ok=True)
    names = set()
    for content in ("a = 1\n", "a = 2\n"):
        source.write_text(content, encoding="utf-8")
        names.add(sources_digest.__wrapped__())
    assert len(names) == 2
    assert all(len(name) == 16 for name in names)
