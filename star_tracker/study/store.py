"""Results of chunks in a folder, a JSON file each, so that a run that was ended resumes."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from star_tracker.resources import write_whole
from star_tracker.study.chunks import Chunk, MapChunk, Outcomes, key


class Store:
    """The results in one folder. Raises ValueError where the folder cannot be made.

    Attributes:
        folder: where the files lie.
        damaged: names of files that could not be used; their chunks count as not done.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.damaged: list[str] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(
                f"{folder} cannot be made a folder: {error.strerror}; choose another --output"
            ) from error

    def load(self, chunk: Chunk) -> list[Outcomes] | None:
        """Return a chunk's result, None for one that is not done or whose file is damaged."""
        path = self._path(chunk)
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        try:
            return _outcomes(chunk, json.loads(text))
        except (ValueError, KeyError, TypeError):
            self.damaged.append(path.name)
            return None

    def save(self, chunk: Chunk, result: list[Outcomes]) -> None:
        """Write a chunk's result, whole or not at all. Raises ValueError where it cannot."""
        path = self._path(chunk)
        content = {"chunk": _description(chunk), "result": [asdict(one) for one in result]}
        try:
            write_whole(path, json.dumps(content))
        except OSError as error:
            raise ValueError(
                f"{path} cannot be written: {error.strerror}; free space or choose another "
                "--output, then start again: what is done is kept"
            ) from error

    def _path(self, chunk: Chunk) -> Path:
        return self.folder / f"{key(chunk)}.json"


def _description(chunk: Chunk) -> dict[str, object]:
    """Return a chunk as JSON has it."""
    described: dict[str, object] = json.loads(json.dumps(asdict(chunk)))
    return described


def _outcomes(chunk: Chunk, content: dict[str, Any]) -> list[Outcomes]:
    """Return the result in a file's content. Raises an error for one that is not the chunk's."""
    if content["chunk"] != _description(chunk):
        raise ValueError("another chunk's result")
    result = [Outcomes(**one) for one in content["result"]]
    if len(result) != len(chunk.contestants):
        raise ValueError("not a result for each contestant")
    if not isinstance(chunk, MapChunk):
        for one in result:
            if not len(one.outcomes) == len(one.error_deg) == len(one.cpu_ms):
                raise ValueError("not a result for each frame")
    return result
