"""Where the package's own files lie, in every way of installing it, and where it may cache."""

import os
import threading
from functools import cache
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

_PACKAGE = "star_tracker"
#: The folders whose sources are compiled, and those that they import.
COMPILED_ROOMS = (
    "attitude", "catalogue", "detection", "geometry", "identification", "optics",
)


def resource_path(name: str) -> Path:
    """Return the path of a shipped file or folder such as `data/hipparcos_v8.npy`.

    Works in a source checkout (and what points into one: an editable install, colcon's
    --symlink-install) and below the `share/star_tracker` of an install prefix (pip, colcon).
    Raises FileNotFoundError with the places that were searched.
    """
    module = Path(__file__).resolve()
    checkout = module.parent.parent
    if (checkout / "package.xml").is_file():
        places = [checkout]
    else:
        places = [parent / "share" / _PACKAGE for parent in module.parents]
    for place in places:
        if (place / name).exists():
            return place / name
    searched = ", ".join(str(place) for place in places if place.exists()) or str(module.parent)
    raise FileNotFoundError(
        f"{name} of the package {_PACKAGE} was not found below {searched}: "
        "the installation is incomplete, install the package again"
    )


@cache
def package_version() -> str:
    """Return this package's version. Its home is package.xml, which all installs have.

    Raises FileNotFoundError where the installation is incomplete.
    """
    return str(ElementTree.parse(resource_path("package.xml")).findtext("version"))


def cache_folder() -> Path | None:
    """Return the folder of what can be made again, None for a user without a home.

    It lies below XDG_CACHE_HOME, or else below the home's `.cache`, and need not exist.
    """
    named = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(named) if named else Path.home() / ".cache") / _PACKAGE
    except RuntimeError:  # no home
        return None


def write_whole(path: Path, text: str) -> None:
    """Write a file in one step: whoever reads it finds all of it or what was there before.

    Raises OSError where the folder or the disk does not take it; nothing is left of it then.
    """
    part = path.with_name(f".{path.name}-{os.getpid()}-{threading.get_ident()}")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@cache
def sources_digest(*more: str) -> str:
    """Name the sources that compiled code and saved features are made of, in all their folders.

    `more` are further sources, by their paths in the package. What is cached under this name was
    made by exactly these sources.
    """
    package = Path(__file__).resolve().parent
    digest = sha256()
    for source in [*_compiled_sources(package), *(package / one for one in more)]:
        digest.update(source.relative_to(package).as_posix().encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def place_digest() -> str:
    """Name where the compiled sources lie and when they were written: numba goes by these too."""
    digest = sha256()
    for source in _compiled_sources(Path(__file__).resolve().parent):
        digest.update(f"{source} {source.stat().st_mtime}\n".encode())
    return digest.hexdigest()[:8]


def _compiled_sources(package: Path) -> list[Path]:
    """Return what compiled code is made of, in an order that is the same everywhere."""
    return [package / "compiled.py"] + [
        source for room in COMPILED_ROOMS for source in sorted((package / room).rglob("*.py"))
    ]
