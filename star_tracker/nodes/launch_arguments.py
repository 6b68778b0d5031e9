"""What the arguments of a launch file say: text in, values out, or one line. No ROS here."""

from pathlib import Path

_WORDS = {"true": True, "false": False}
_POLICIES = {
    "reliability": ("reliable", "best_effort"), "durability": ("volatile", "transient_local"),
}


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


def quality(name: str, text: str, topic: str) -> dict[str, object]:
    """Return the parameter that overrides a policy of a topic's QoS; none for an empty text.

    Args:
        name: of the argument; its last word is the policy.
        text: what it says.
        topic: as the node has it in the end, and what it does: `/image.subscription`.

    Raises ValueError, in one line, for what is no such policy.
    """
    if not text:
        return {}
    policy = name.rpartition("_")[2]
    if text not in _POLICIES[policy]:
        raise ValueError(f"{name}:={text} must be {' or '.join(_POLICIES[policy])}")
    return {f"qos_overrides.{topic}.{policy}": text}


def resolved(namespace: str, topic: str) -> str:
    """Return the whole name of a topic of a node in a namespace."""
    if topic.startswith("/"):
        return topic
    return "/" + "/".join(part for part in (namespace.strip("/"), topic) if part)


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
