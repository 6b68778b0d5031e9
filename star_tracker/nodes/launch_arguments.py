"""What the arguments of a launch file say: text in, values out, or one line. No ROS here."""

from pathlib import Path

_WORDS = {"true": True, "false": False}


def switch(name: str, text: str) -> bool:
    """Return what an argument says. Raises ValueError, in one line, for what is no such word."""
    if text.lower() not in _WORDS:
        raise ValueError(f"{name}:={text} must be true or false")
    return _WORDS[text.lower()]


def pixels(name: str, text: str) -> int:
    """Return a number of pixels. Raises ValueError, in one line, for what is no such number."""
    if not (text.isascii() and text.isdecimal()):
        raise ValueError(f"{name}:={text} must be a whole number of pixels")
    return int(text)


def number(name: str, text: str) -> float:
    """Return a number. Raises ValueError, in one line, for what is none."""
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"{name}:={text} must be a number") from error


def triple(name: str, text: str) -> list[float]:
    """Return three numbers. Raises ValueError, in one line, for what is none."""
    try:
        x, y, z = (float(word) for word in text.strip("[] ").split(","))
    except ValueError as error:
        raise ValueError(f"{name}:={text} must be three numbers, [x, y, z]") from error
    return [x, y, z]


def files(name: str, text: str) -> list[object]:
    """Return the file of parameters, of an empty text none.

    Launch itself only warns of a file that is not there, and starts the node with its defaults.
    Raises ValueError, in one line, for such a file.
    """
    if not text:
        return []
    if not Path(text).is_file():
        raise ValueError(f"{name}:={text} is not there")
    return [text]
