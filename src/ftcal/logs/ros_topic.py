"""A topic of a bag, and a batch of its messages as the bytes that were recorded.

Whatever the container, messages come in batches: one buffer, where each message starts in it, how
long it is, and when it arrived. Decoding (`ros_messages`) knows nothing of files, and the readers
of files (`ros_mcap`, `ros_files`) know nothing of messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import FtcalError, LogError

if TYPE_CHECKING:
    from jaxtyping import Int, UInt8
    from numpy import ndarray as Array

SEPARATOR = "=" * 80 + "\n"
"""Parts the files of a concatenated message definition."""

LONGEST = 1 << 20
"""Most items of one array in a message; more is a broken count, not a sensor."""


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag says of one stream of messages."""

    name: str
    kind: str
    """Message type as ROS 2 spells it, such as `sensor_msgs/msg/JointState`."""
    definition: str
    """Text of the type and of those it is made of; "" where the bag has none."""
    language: str
    """`ros1msg`, `ros2msg` or `ros2idl`; "" without a definition."""
    wire: str
    """How messages are packed: `cdr` (ROS 2) or `ros1`; anything else is not read."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Messages of one topic in the order of the file."""

    topic: Topic
    buffer: UInt8[Array, "B"]
    """The messages and whatever lies between them."""
    starts: Int[Array, "N"]
    """First byte of each message in `buffer`."""
    lengths: Int[Array, "N"]
    """Bytes of each message."""
    arrival: Int[Array, "N"]
    """When the recorder got each message [ns since the Unix epoch]."""

    def __len__(self) -> int:
        return len(self.starts)

    def some(self, rows: Int[Array, "M"]) -> Batch:
        """Return the messages `rows`, which rise; all of them, as a rule, and nothing is copied."""
        if len(rows) == len(self):
            return self
        return replace(
            self, starts=self.starts[rows], lengths=self.lengths[rows], arrival=self.arrival[rows]
        )

    def message(self, row: int) -> bytes:
        """Return the bytes of one message."""
        start = int(self.starts[row])
        return self.buffer[start : start + int(self.lengths[row])].tobytes()


def batch(topic: Topic, messages: Sequence[bytes], arrival: Sequence[int]) -> Batch:
    """Return `messages`, bytes each, as one batch."""
    lengths = np.array([len(message) for message in messages], dtype=np.int64)
    buffer = np.frombuffer(b"".join(messages), np.uint8)
    starts = np.cumsum(lengths) - lengths
    return Batch(topic, buffer, starts, lengths, np.array(arrival, dtype=np.int64))


def full_kind(name: str) -> str:
    """Return a message type as ROS 2 spells it: ROS 1 leaves out the `msg` in the middle."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


def definitions(topic: Topic) -> Mapping[str, Any]:
    """Return the fields of the type of `topic` and of those it is made of, as `rosbags` has them.

    From the bag, else those of ROS 2 Humble: the last distribution whose sqlite3 bags carry no
    definitions; the types read here are the same in all. Raises what `rosbags` raises.
    """
    return _parsed(topic.definition, topic.language, topic.kind)


@lru_cache(maxsize=64)  # rosbags takes milliseconds, and all bags of a fleet say the same
def _parsed(definition: str, language: str, kind: str) -> Mapping[str, Any]:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not definition:
        return get_typestore(Stores.ROS2_HUMBLE).fielddefs
    if language == "ros2idl":
        texts = [part for part in definition.split(SEPARATOR) if part.strip()]
        parts = [_without_title(text) for text in texts]
        return {name: v for part in parts for name, v in get_types_from_idl(part).items()}
    return get_types_from_msg(definition, kind)


def typestore(definitions: Mapping[str, Any]) -> Any:
    """Return what decodes messages of these types, one by one. Raises what `rosbags` raises."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(dict(definitions))
    store.max_sequence_length = LONGEST
    return store


def _without_title(idl: str) -> str:
    """Return the text of one IDL file without the line that names it in a concatenation."""
    title, _, rest = idl.partition("\n")
    return rest if title.startswith("IDL: ") else idl


@contextmanager
def no_foreign_errors(where: str) -> Iterator[None]:
    """Turn whatever a library raises on broken bytes into a `LogError` that names `where`.

    The libraries' readers let assertions, struct, index, unicode and key errors through.
    """
    try:
        yield
    except FtcalError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0][:200]
        what = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        raise LogError(
            f"{where}: damaged or cut short ({what}); recover it (`rosbag reindex`,"
            " `ros2 bag reindex`, `mcap recover`) or record again"
        ) from error
