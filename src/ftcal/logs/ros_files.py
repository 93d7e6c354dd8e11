"""Which files a bag is made of, and the messages in ROS 1 and sqlite3 bags.

| looks like | is |
|---|---|
| `.bag`, or a folder of them | ROS 1 |
| `.mcap`, `.db3`, either as `.zstd` | ROS 2, one file |
| a folder with `metadata.yaml` | ROS 2, the files it lists in its order |
| a folder with `.mcap` or `.db3` alone | ROS 2, a recorder that did not end; files by name |
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ftcal.errors import LogError
from ftcal.logs.ros_topic import Batch, Topic, batch, no_foreign_errors
from ftcal.logs.ros_zstd import inflated

SUFFIXES = frozenset({".bag", ".mcap", ".db3"})
"""Endings of bags; those of ROS 2 may be followed by `.zstd`."""

METADATA = "metadata.yaml"

BATCH = 4096
"""Messages of one topic that are decoded together."""


@dataclass(frozen=True, slots=True)
class Bag:
    """The files of one recording."""

    files: tuple[Path, ...]
    """In the order in which they were written."""
    metadata: Path | None
    """What the recorder says of them."""
    squeezed: bool = False
    """Whether every message was compressed by itself."""


def kind_of(file: Path) -> str:
    """Return the suffix that says how to read `file`, without `.zstd`; "" for no bag."""
    ending = Path(file.stem).suffix if file.suffix.lower() == ".zstd" else file.suffix
    return ending.lower() if ending.lower() in SUFFIXES else ""


def title(path: Path) -> str:
    """Return the name of a bag: that of the folder, or of the file without its endings."""
    if path.is_dir():
        return path.name
    return Path(path.stem).stem if path.suffix.lower() == ".zstd" else path.stem


def bags(folder: Path) -> list[Path]:
    """Return the bag files in `folder`, in the order of the numbers in their names."""
    found = [file for file in folder.iterdir() if kind_of(file) and file.is_file()]
    return sorted(found, key=lambda file: [int(part) if part.isdecimal() else part
                                           for part in re.split(r"(\d+)", file.name)])  # fmt: skip


def holds(path: Path) -> bool:
    """Return whether `path` is a bag, or a folder of one."""
    if not path.is_dir():
        return path.is_file() and bool(kind_of(path))
    said = path / METADATA
    return bool(bags(path)) or (said.is_file() and b"rosbag2_bagfile" in said.read_bytes())


def find(path: Path) -> Bag:
    """Return the files of the bag at `path`; `LogError` where some are missing or of two kinds."""
    if not path.is_dir():
        return Bag((path,), None)
    said = path / METADATA
    if said.is_file():
        return _listed(path, said)
    files = bags(path)
    if len(kinds := sorted({kind_of(file) for file in files})) != 1:
        raise LogError(f"{path}: bags of {len(kinds)} kinds {' '.join(kinds)}; give one of them")
    return Bag(tuple(files), None)


def _listed(folder: Path, said: Path) -> Bag:
    with no_foreign_errors(str(said)):
        from ruamel.yaml import YAML

        content = YAML(typ="safe", pure=True).load(said.read_text())["rosbag2_bagfile_information"]
        names = [PurePosixPath(name).name for name in content["relative_file_paths"]]
        mode = str(content.get("compression_mode") or "").lower()
        method = str(content.get("compression_format") or "")
    if mode == "message" and method != "zstd":
        raise LogError(f"{said}: messages are compressed with {method!r}; rewrite them with zstd")
    files = tuple(folder / name for name in names)
    faults = [file.name for file in files if not file.is_file()]
    if faults or not files:
        raise LogError(f"{said}: lists {', '.join(faults) or 'no file'}, which is not there;"
                       " copy it, or run `ros2 bag reindex`")  # fmt: skip
    if len(kinds := sorted({kind_of(file) for file in files})) != 1 or not kinds[0]:
        raise LogError(f"{said}: lists files of kinds {kinds}; .mcap or .db3 are read")
    return Bag(files, said, squeezed=mode == "message")


class RosbagsFile:
    """One ROS 1 bag or sqlite3 file, read by `rosbags`."""

    def __init__(self, path: Path, title: str, *, squeezed: bool) -> None:
        """Prepare to read `path`; `title` names it in errors, `squeezed` messages are zstd."""
        self.counts: Counter[Topic] = Counter()
        """Messages by topic, whether wanted or not."""
        self.faults: list[str] = []
        """What is missing from the file: `rosbags` reads a file whole or not at all."""
        self._path, self._title, self._squeezed = path, title, squeezed

    def batches(self, wanted: Callable[[Topic], bool]) -> Iterator[Batch]:
        """Return the messages of the wanted topics; `LogError` where the file is damaged."""
        with no_foreign_errors(self._title), self._reader() as reader:
            topics = {c.id: self._topic(c) for c in reader.connections}
            for connection in reader.connections:
                self.counts[topics[connection.id]] += connection.msgcount
            chosen = [c for c in reader.connections if wanted(topics[c.id])]
            if not chosen:  # to `rosbags` no connection means all of them
                return
            waiting: dict[int, tuple[list[bytes], list[int]]] = {}
            for connection, arrival, message in reader.messages(connections=chosen):
                messages, arrivals = waiting.setdefault(connection.id, ([], []))
                messages.append(message)
                arrivals.append(arrival)
                if len(messages) == BATCH:
                    yield self._batch(topics[connection.id], *waiting.pop(connection.id))
            for number, found in waiting.items():
                yield self._batch(topics[number], *found)

    def _reader(self) -> Any:
        if kind_of(self._path) == ".bag":
            from rosbags.rosbag1 import Reader

            return Reader(self._path)
        from rosbags.rosbag2 import Reader as Reader2

        return Reader2(self._path)

    def _topic(self, connection: Any) -> Topic:
        ros1 = kind_of(self._path) == ".bag"
        language = {0: "", 1: "ros1msg" if ros1 else "ros2msg", 2: "ros2idl"}
        return Topic(
            str(connection.topic),  # sqlite gives whatever lies in the cell
            str(connection.msgtype),
            connection.msgdef.data,
            language[connection.msgdef.format.value],
            "ros1" if ros1 else connection.ext.serialization_format,
        )

    def _batch(self, topic: Topic, messages: list[bytes], arrival: list[int]) -> Batch:
        found = batch(topic, messages, arrival)
        return inflated(found, self._title) if self._squeezed else found
