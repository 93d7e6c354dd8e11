"""The nested lines of a `measures:o` port: one list per kind of sensor, in a fixed order.

An entry is `((values) stamp)`, however deep the lists around it. Which field of the line is which
sensor is read from the first line; the others have the same lists (YARP, MultipleAnalogSensors).
"""

from __future__ import annotations

from dataclasses import replace

from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import WRENCH_AXES
from ftcal.recording import Signal

KINDS = ("gyroscope", "accelerometer", "magnetometer", "orientation", "temperature", "ft",
         "load cell", "encoders", "skin")  # fmt: skip
"""Kinds of sensors in the order of their lists."""

_COLUMNS = {
    "gyroscope": ("gx", "gy", "gz"),
    "accelerometer": ("ax", "ay", "az"),
    "temperature": ("temperature",),
    "ft": WRENCH_AXES,
}
_ROLES = {"ft": "channels", "temperature": "temperatures"}


def fields(first: bytes) -> dict[int, str]:
    """Return field of the line → `<kind> <number>/<column>` of every value that is read."""
    kind, field, count = -1, 0, dict.fromkeys(KINDS, 0)
    lists: list[list[int]] = []
    found: dict[int, str] = {}
    for letter in first:
        if letter == ord("("):
            kind += not lists
            if lists:
                lists[-1].append(-1)  # a list around lists: its own number is a stamp
            lists.append([])
        elif letter == ord(")") and lists:
            inner = lists.pop()
            name = KINDS[kind] if kind < len(KINDS) else ""
            if inner and -1 not in inner and len(inner) == len(_COLUMNS.get(name, ())):
                titles = (f"{name} {count[name]}/{axis}" for axis in _COLUMNS[name])
                found |= dict(zip(inner, titles, strict=True))
                count[name] += 1
        elif letter == ord(" "):
            field += 1
        elif lists and field not in lists[-1]:
            lists[-1].append(field)
    return found


def split(port: Signal, notes: tuple[Note, ...]) -> Streams:
    """Return the sensors of `port`, whose columns are called as `fields` calls them.

    A sensor that is the only one of its kind is called like the port, others `<port>/<number>`;
    gyroscopes and accelerometers are imus, called `<port>/gyroscope 0` and so on.
    """
    sensors: dict[str, list[int]] = {}
    for column, title in enumerate(port.columns):
        sensors.setdefault(title.partition("/")[0], []).append(column)
    streams: dict[str, list[Signal]] = {"channels": [], "temperatures": [], "imus": []}
    for sensor, columns in sensors.items():
        kind, number = sensor.split(" ")
        alone = f"{kind} 1" not in sensors
        role = _ROLES.get(kind, "imus")
        ending = f"/{sensor}" if role == "imus" else "" if alone else f"/{number}"
        names = tuple(port.columns[column].partition("/")[2] for column in columns)
        streams[role].append(
            replace(port, name=port.name + ending, columns=names, values=port.values[:, columns])
        )
    return Streams(notes=notes, **{role: tuple(signals) for role, signals in streams.items()})
