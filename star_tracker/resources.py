"""Where the package's own data and configuration lie, in every way of installing it."""

from pathlib import Path

_PACKAGE = "star_tracker"


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
