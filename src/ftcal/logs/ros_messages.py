"""Messages → columns: which message types are read, and which of their fields.

| type | becomes | columns |
|---|---|---|
| `sensor_msgs/JointState` | joint positions | its names |
| `geometry_msgs/WrenchStamped` | F/T channels | `fx fy fz tx ty tz` |
| `sensor_msgs/Imu` | IMU: proper acceleration, angular velocity | `ax ay az gx gy gz` |
| `sensor_msgs/Temperature` | temperature | `temperature` |
| `std_msgs/Float64MultiArray` …, `geometry_msgs/Wrench` | F/T channels, on request | the layout's |

On request: where the layout names the topic as channels; so may any other.

Messages that are packed alike are read at once (`ros_layout`), the others one by one by `rosbags`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ftcal.logs.layout import WRENCH_AXES
from ftcal.logs.pieces import Role
from ftcal.logs.ros_layout import ByteLayout, UnfitError, learn
from ftcal.logs.ros_topic import Batch, Topic, definitions, no_foreign_errors, typestore
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

IMU_AXES = ("ax", "ay", "az", "gx", "gy", "gz")
"""Proper acceleration [m/s^2], then angular velocity [rad/s], in the frame of the unit."""

FORMS = 16
"""Ways of packing that are learnt for one topic; what differs more often is read one by one."""

_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_FRAME = "header.frame_id"


@dataclass(frozen=True, slots=True)
class Kind:
    """What is read of a message type."""

    role: Role
    """Field of `Streams` that it fills."""
    values: tuple[str, ...]
    """Paths of the fields with numbers."""
    columns: tuple[str, ...] = ()
    """Names of the numbers; () where the message or the layout says."""
    names: str = ""
    """Path of the field with the names of the numbers."""
    stamped: bool = True
    """Whether messages say when they were measured."""
    framed: bool = True
    """Whether messages say in which frame, and frames part what shares a topic."""
    withheld: tuple[str, ...] = ()
    """Fields whose first number is -1 where the message says that it has no such measurement."""


def _triple(path: str) -> tuple[str, ...]:
    return tuple(f"{path}.{axis}" for axis in "xyz")


JOINTS = Kind("joints", ("position",), names="name", framed=False)

KINDS = {
    "sensor_msgs/msg/JointState": JOINTS,
    "geometry_msgs/msg/WrenchStamped": Kind(
        "channels", (*_triple("wrench.force"), *_triple("wrench.torque")), WRENCH_AXES
    ),
    "sensor_msgs/msg/Imu": Kind(
        "imus",
        (*_triple("linear_acceleration"), *_triple("angular_velocity")),
        IMU_AXES,
        withheld=("linear_acceleration_covariance", "angular_velocity_covariance"),
    ),
    "sensor_msgs/msg/Temperature": Kind("temperatures", ("temperature",), ("temperature",)),
}
"""Message types that are read wherever they are met."""

ON_REQUEST = {
    "geometry_msgs/msg/Wrench": Kind(
        "channels",
        (*_triple("force"), *_triple("torque")),
        WRENCH_AXES,
        stamped=False,
        framed=False,
    ),
    **{
        f"std_msgs/msg/{number}MultiArray": Kind("channels", ("data",), stamped=False, framed=False)
        for number in ("Float64", "Float32", "Int64", "Int32", "Int16", "UInt32", "UInt16")
    },
}
"""Message types that are read where the layout names their topic as channels."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Messages of one topic that carry the same names and frame, in the order of the file."""

    names: tuple[str, ...]
    frame: str
    """Frame of the header; "" without one, and for joints, which have no frame."""
    stamps: Int[Array, "N"]
    """Nanoseconds, of the header; of arrival where there is none."""
    arrival: Int[Array, "N"]
    """Nanoseconds."""
    values: Float[Array, "N K"]
    withheld: Bool[Array, "N"]
    """Whether the message says that it has no such measurement."""

    @property
    def key(self) -> tuple[str, frozenset[str]]:
        """Frame and names: what parts the messages of one topic into signals."""
        return self.frame, frozenset(self.names)


@dataclass(frozen=True, slots=True)
class _Form:
    layout: ByteLayout
    names: tuple[str, ...]
    frame: str


class Decoder:
    """Reads the messages of one topic; learns on the way how they are packed."""

    def __init__(self, topic: Topic, kind: Kind, where: str) -> None:
        """Prepare for `topic`; `LogError` where its definition is none, or is not that type's."""
        self._topic, self._kind, self._where = topic, kind, where
        self._forms: list[_Form] = []
        self._tried = 0
        with no_foreign_errors(f"{where}: definition of {topic.kind}"):
            self._definitions = definitions(topic)

    @cached_property
    def _unpack(self) -> Callable[[bytes, str], Any]:
        """What decodes one message; made when a message needs it, for that takes a while."""
        store = typestore(self._definitions)
        unpack = store.deserialize_cdr if self._topic.wire == "cdr" else store.deserialize_ros1
        return cast("Callable[[bytes, str], Any]", unpack)

    def pieces(self, batch: Batch) -> list[Piece]:
        """Return the messages of `batch`, those packed alike together.

        Raises `LogError` where a message is not what its type says.
        """
        with no_foreign_errors(f"{self._where}: a message"):
            return list(self._pieces(batch))

    def _pieces(self, batch: Batch) -> Iterator[Piece]:
        waiting = np.arange(len(batch))
        for form in self._forms:
            waiting, piece = self._take(batch, waiting, form)
            yield from piece
        while len(waiting) and self._tried < FORMS:
            self._tried += 1
            if (learnt := self._learn(batch.message(int(waiting[0])))) is None:
                yield from self.one_by_one(batch, waiting[:1])
                waiting = waiting[1:]
            else:
                self._forms.append(learnt)
                waiting, piece = self._take(batch, waiting, learnt)
                yield from piece
        yield from self.one_by_one(batch, waiting)

    def one_by_one(self, batch: Batch, rows: Int[Array, "M"]) -> Iterator[Piece]:
        """Return the messages `rows` of `batch`, each decoded by `rosbags`."""
        kind = self._kind
        found: dict[tuple[tuple[str, ...], str, int], list[tuple[int, int, list[float], bool]]] = {}
        for row in rows.tolist():
            message = self._unpack(batch.message(row), self._topic.kind)
            values = [float(x) for path in kind.values for x in np.ravel(_at(message, path))]
            arrival = int(batch.arrival[row])
            stamp = _stamp(message) if kind.stamped else arrival
            withheld = any(_at(message, path)[0] == -1.0 for path in kind.withheld)
            names = tuple(_at(message, kind.names)) if kind.names else kind.columns
            frame = str(_at(message, _FRAME)) if kind.framed else ""
            key = (names, frame, len(values))
            found.setdefault(key, []).append((stamp, arrival, values, withheld))
        for (names, frame, width), messages in found.items():
            stamps, arrivals, values_2d, withheld_1d = zip(*messages, strict=True)
            yield Piece(
                names,
                frame,
                np.array(stamps, dtype=np.int64),
                np.array(arrivals, dtype=np.int64),
                np.array(values_2d, dtype=np.float64).reshape(len(messages), width),
                np.array(withheld_1d, dtype=bool),
            )

    def _take(
        self, batch: Batch, waiting: Int[Array, "M"], form: _Form
    ) -> tuple[Int[Array, "L"], list[Piece]]:
        """Return the rows that are packed otherwise, and those packed as `form` says."""
        layout = form.layout
        some = batch.some(waiting)
        alike = some.lengths == len(layout.first)
        if not alike.any():
            return waiting, []
        some = some.some(np.flatnonzero(alike))
        agrees = layout.agrees(some.buffer, some.starts)
        if not agrees.all():
            alike[alike] = agrees
            some = some.some(np.flatnonzero(agrees))
        return waiting[~alike], [self._piece(some, form)] if len(some) else []

    def _piece(self, batch: Batch, form: _Form) -> Piece:
        layout, kind = form.layout, self._kind
        buffer, starts, arrival = batch.buffer, batch.starts, batch.arrival
        stamps = arrival
        if kind.stamped:
            sec, nanosec = (layout.read(buffer, starts, p)[:, 0].astype(np.int64) for p in _STAMP)
            stamps = sec * NANOSECONDS + nanosec
        withheld = np.zeros(len(starts), dtype=bool)
        for path in kind.withheld:
            withheld |= layout.read(buffer, starts, path)[:, 0] == -1.0
        values = layout.table(buffer, starts, kind.values)
        return Piece(form.names, form.frame, stamps, arrival, values, withheld)

    def _learn(self, message: bytes) -> _Form | None:
        kind = self._kind
        try:
            layout = learn(message, self._topic.kind, self._definitions, wire=self._topic.wire)
        except UnfitError:
            return None
        wanted = (*kind.values, *kind.withheld, *(_STAMP if kind.stamped else ()))
        if any(p not in layout.places for p in wanted) or (
            kind.framed and _FRAME not in layout.texts
        ):
            return None
        said = [t for path, t in layout.texts.items() if path.startswith(f"{kind.names}.")]
        frame = layout.texts[_FRAME] if kind.framed else ""
        return _Form(layout, tuple(said) if kind.names else kind.columns, frame)


def _at(message: Any, path: str) -> Any:
    return reduce(getattr, path.split("."), message)


def _stamp(message: Any) -> int:
    sec, nanosec = (int(_at(message, path)) for path in _STAMP)
    return sec * NANOSECONDS + nanosec
