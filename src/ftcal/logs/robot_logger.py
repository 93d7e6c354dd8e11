"""robot-logger files (`.mat`, MATLAB v7.3): what each stream of the robot is.

Signals are called by their path below `robot_logger_device`, such as `FTs/l_leg_ft`.

| leaf | becomes | unit, where the leaf declares none |
|---|---|---|
| `joints_state/positions` | joints; older files name them in `description_list` alone | rad |
| `FTs/<sensor>` | F/T channels | N, Nm, or counts |
| `temperatures/<sensor>` | temperature | degree Celsius |
| `accelerometers/…`, `gyros/…`, `orientations/…` | imus | m/s^2, rad/s, rad |

Other leaves are left alone unless the layout names them. Names and units are those of robot-logger
(bipedal-locomotion-framework, `YarpRobotLoggerDevice`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ftcal.errors import LogError, raise_all, unknown
from ftcal.logs import columns, matlab
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import WRENCH_AXES, Layout
from ftcal.logs.matlab import Leaf
from ftcal.logs.tables_time import nanoseconds
from ftcal.logs.units import ACCELERATIONS, ANGULAR_VELOCITIES, factor, spelt
from ftcal.recording import Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SUFFIX = ".mat"
"""File names that are read as robot-logger's."""

JOINTS = "joints_state/positions"
"""Leaf of the measured joint positions."""

HABITS = {"FTs": "channels", "temperatures": "temperatures", "accelerometers": "imus",
          "gyros": "imus", "orientations": "imus"}  # fmt: skip
"""Group → role of the leaves in it."""

AXES = {"accelerometers": ("ax", "ay", "az"), "gyros": ("gx", "gy", "gz"),
        "orientations": ("roll", "pitch", "yaw")}  # fmt: skip
"""Group → columns of its leaves, where a file names none."""

_KNOWN = (*HABITS, "joints_state")


def read(file: Path, layout: Layout, *, name: str | None = None) -> Recording:
    """Return the recording in the `.mat` file of a robot-logger.

    The layout's channels and imus map a signal to the leaves whose columns it joins (one clock);
    its temperatures map a signal to a leaf, its joints a leaf to joint names. Raises `LogError`
    where the file is no MATLAB v7.3, lacks what the layout names, or a stream makes no sense.
    """
    wanted = {leaf for said in (layout.channels, layout.imus) for s in said.values() for leaf in s}
    wanted |= {*layout.temperatures.values(), *layout.joints}
    contents = matlab.load(
        file,
        lambda path: path == JOINTS or path in wanted or path.partition("/")[0] in HABITS,
        _KNOWN,
    )
    leaves = contents.leaves
    faults = [
        f"{unknown('leaf', leaf, leaves)}; the layout must name one"
        for leaf in sorted(wanted - set(leaves))
    ]
    raise_all(LogError, str(file), faults)
    reader = _Reader(file, layout, leaves)
    streams = columns.merge([*reader.joints(contents.described), *reader.others()])
    start = min((int(s.stamps[0]) for s in streams.signals), default=0)
    notes = tuple(
        Note("empty", path, start, start, "set up but logged no sample") for path in contents.empty
    )
    return columns.recording(
        columns.merge([streams, Streams(notes=notes)]),
        name=name or file.stem,
        source=str(file),
        zero=layout.zero,
        sha256=columns.digest([columns.file_sha256(file)]),
    )


@dataclass(frozen=True, slots=True)
class _Reader:
    """Leaves of one file → signals."""

    file: Path
    layout: Layout
    leaves: Mapping[str, Leaf]
    """By path."""

    def joints(self, described: tuple[str, ...]) -> Iterator[Streams]:
        """Yield the joints: of the leaves that the layout names, else of the measured ones."""
        for name in self.layout.joints or {JOINTS} & set(self.leaves):
            leaf = self.leaves[name]
            width = leaf.values.shape[1]
            said = self.layout.joints.get(name) or leaf.names or described
            if len(said) != width:
                raise LogError(
                    f"{self.file}, {name}: {width} columns but {len(said)} names; say in the job"
                    f' joints = {{ "{name}" = ["JOINT", ...] }}'
                )
            angle = self.layout.angle
            units = leaf.units if angle is None else (angle,) * width
            used = [column for column, title in enumerate(said) if title]
            values = _ordered(_in_si(leaf.values, units), used)
            yield self.stream("joints", name, [said[c] for c in used], values, leaf)

    def others(self) -> Iterator[Streams]:
        """Yield F/T channels, temperatures and imus: as the layout says, then by habit."""
        layout = self.layout
        claims: dict[str, dict[str, tuple[str, ...]]] = {
            "channels": dict(layout.channels),
            "temperatures": {signal: (leaf,) for signal, leaf in layout.temperatures.items()},
            "imus": dict(layout.imus),
        }
        taken = {leaf for said in claims.values() for parts in said.values() for leaf in parts}
        for leaf in self.leaves:
            role = HABITS.get(leaf.partition("/")[0])
            if role is not None and leaf not in taken and leaf not in layout.joints:
                claims[role][leaf] = (leaf,)
        for role, signals in claims.items():
            for signal, parts in signals.items():
                yield self.joined(role, signal, parts)

    def joined(self, role: str, name: str, parts: Sequence[str]) -> Streams:
        """Return the signal `name` with the columns of the leaves `parts`."""
        clock = self.leaves[parts[0]]
        # a unit that the job names is applied to all formats alike, after the reader
        overruled = ACCELERATIONS if self.layout.acceleration else frozenset[str]()
        overruled |= ANGULAR_VELOCITIES if self.layout.angular_velocity else frozenset()
        titles: list[str] = []
        blocks = []
        for part in parts:
            leaf = self.leaves[part]
            if not np.array_equal(leaf.stamps, clock.stamps):
                raise LogError(f"{self.file}: {parts[0]!r} and {part!r} have clocks of their own;"
                               f" {name!r} cannot join them")  # fmt: skip
            width = leaf.values.shape[1]
            order, names = list(range(width)), leaf.names or _plain_names(part, width)
            if role == "channels":
                order, names = _wrench_first(leaf.names, width)
            units = ["" if spelt(unit) in overruled else unit for unit in leaf.units]
            blocks.append(_ordered(_in_si(leaf.values, units), order))
            titles += names
        if role == "temperatures":
            if len(titles) != 1:
                raise LogError(f"{self.file}, {name}: {len(titles)} columns; a thermometer has one")
            titles = ["temperature"]
        return self.stream(role, name, titles, np.hstack(blocks), clock)

    def stream(
        self, role: str, name: str, titles: Sequence[str], values: Float[Array, "N K"], leaf: Leaf
    ) -> Streams:
        """Return one signal in its role, with what is noticed of its clock."""
        where = f"{self.file}, {name}"
        columns.require_finite(values, titles, where, first_row=1)
        stamps = nanoseconds(
            pa.chunked_array([leaf.stamps]), self.layout.time_unit, f"{where}, timestamps",
            first_row=1,
        )  # fmt: skip
        signal = Signal(name, tuple(titles), stamps, values)
        signal, _, notes = columns.in_order(signal, where, first_row=1)
        return Streams(notes=notes, **{role: (signal,)})


def _plain_names(path: str, width: int) -> tuple[str, ...]:
    """Return what the columns of a leaf without names are called."""
    names = AXES.get(path.partition("/")[0], ())
    return names if len(names) == width else tuple(f"c{k}" for k in range(width))


def _wrench_first(names: tuple[str, ...], width: int) -> tuple[list[int], tuple[str, ...]]:
    """Return order and names of F/T channels; six that say which axis they are: force first.

    robot-logger calls them f_x, f_y, f_z, mu_x, mu_y, mu_z.
    """
    plain = [n.lower().replace("_", "").replace("mu", "t").replace("m", "t") for n in names]
    if sorted(plain) == sorted(WRENCH_AXES):
        return [plain.index(axis) for axis in WRENCH_AXES], WRENCH_AXES
    if width == len(WRENCH_AXES) and not names:
        return list(range(width)), WRENCH_AXES
    return list(range(width)), names or tuple(f"ch{k}" for k in range(width))


def _in_si(values: Float[Array, "N K"], units: Sequence[str]) -> Float[Array, "N K"]:
    """Return `values` turned from `units` of each column; what nobody knows is left as logged."""
    known = units if len(units) == values.shape[1] else ()
    factors = [factor(unit) or 1.0 for unit in known]
    return values * np.array(factors) if set(factors) - {1.0} else values


def _ordered(values: Float[Array, "N K"], order: list[int]) -> Float[Array, "N K"]:
    """Return the columns of `values` in `order`, without a copy where that is theirs."""
    return values if order == list(range(values.shape[1])) else values[:, order]
