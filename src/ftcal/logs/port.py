"""One port of a YARP dump, all its sessions → one signal.

Sessions are connections noted in one `info.log`, or folders of one port that the dumper numbered
(`_00001`, …); between two of them the signal has a break.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ftcal.errors import LogError
from ftcal.logs import columns, dump, measures
from ftcal.logs.columns import Note, Streams
from ftcal.logs.dump import CONNECTION, SAMPLES
from ftcal.logs.layout import WRENCH_AXES, Layout, part_joints
from ftcal.logs.packets import Counter, Sessions
from ftcal.logs.pieces import joined
from ftcal.recording import NANOSECONDS, Signal

NUMBERED = re.compile(r"_\d{5}$")
"""What the dumper appends to the name of a folder that is there already."""

MEASURES = "measures"
"""Role of a port that carries sensors of several kinds."""

_INERTIAL = ("roll", "pitch", "yaw", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")


@dataclass(frozen=True, slots=True)
class Port:
    """One folder of a dump."""

    folder: Path
    name: str
    """The port without the robot's name, such as `right_leg/analog:o`."""
    role: str
    """The field of `Streams` that it fills, or `MEASURES`; "" where it is not read."""
    link: dump.Connection
    """What `info.log` says."""

    @property
    def samples(self) -> Path:
        """The file with the samples."""
        return self.folder / SAMPLES

    @property
    def files(self) -> list[Path]:
        """The files that there are."""
        return [file for file in (self.samples, self.folder / CONNECTION) if file.is_file()]


def same(root: Path, ports: Sequence[Port]) -> None:
    """Raise `LogError` where `ports` of one name are not the sessions of one port."""
    homes = {tuple(NUMBERED.sub("", p) for p in p.folder.relative_to(root).parts) for p in ports}
    if len(homes) > 1:
        where = ", ".join(str(port.folder) for port in ports[:2])
        raise LogError(f"{where}: both hold port {ports[0].name!r}; read one recording at a time")


def read(root: Path, ports: Sequence[Port], layout: Layout) -> tuple[Streams, list[bytes]]:
    """Return the one signal of `ports`, the sessions of one port, and the SHA-256 of each file.

    Raises `LogError` where a session cannot be read, or two cannot be sessions of one port.
    """
    same(root, ports)
    notes: list[Note] = []
    sums: list[bytes] = []
    sessions: list[Signal] = []
    for port in ports:
        with ThreadPoolExecutor(1) as beside:
            digests = beside.map(columns.file_sha256, port.files)
            signal, noticed = _session(port, layout)
        notes += noticed
        sums += digests
        if len(signal):
            sessions.append(signal)
    if not sessions:
        return Streams(notes=tuple(notes)), sums
    sessions.sort(key=lambda s: int(s.stamps[0]))
    apart([(int(s.stamps[0]), int(s.stamps[-1]), s.values.shape[1]) for s in sessions], ports)
    return streams(_join(sessions), ports[0], notes), sums


def streams(signal: Signal, port: Port, notes: Iterable[Note] = ()) -> Streams:
    """Return the signals that the `signal` of a port is, by its role."""
    if port.role == MEASURES:
        return measures.split(signal, tuple(notes))
    return Streams(notes=tuple(notes), **{port.role: (signal,)})


def _session(port: Port, layout: Layout) -> tuple[Signal, list[Note]]:
    """Return the samples of one folder as a signal, and what was noticed."""
    reading = Reading.of(port, layout)
    samples = dump.NOTHING
    if reading.lines.width:
        samples = dump.parse(port.samples, reading.lines, scale=reading.scale)
    signal = reading.signal(samples)
    columns.require_finite(signal.values, signal.columns, str(port.samples), first_row=1)
    signal, _, noticed = columns.in_order(signal, str(port.samples), first_row=1)
    sessions, counter = Sessions(port.link), Counter()
    sessions.see(signal.stamps)
    counter.see(samples.sequence)
    lost = counter.lost([(samples.sequence, samples.stamps)], sessions.opening)
    ends = (int(signal.stamps[0]), int(signal.stamps[-1])) if len(signal) else None
    notes = [*noticed, *reading.notes(ends, len(samples.stamps), lost)]
    breaks = np.searchsorted(signal.stamps, sessions.opening).tolist()
    return replace(signal, breaks=tuple(breaks)), notes


@dataclass(frozen=True, slots=True)
class Reading:
    """How the samples of one folder become a signal."""

    port: Port
    layout: Layout
    lines: dump.Form
    """The form of its lines; no fields where there are no samples."""
    titles: tuple[str, ...] | None
    """Name of each value where the first line says it; None: the layout does."""

    @classmethod
    def of(cls, port: Port, layout: Layout) -> Reading:
        """Return how `port` is read; `LogError` where its first line is no sample."""
        lines, fields = dump.Form(), None
        if port.samples.is_file():
            if port.role == MEASURES:
                fields = measures.fields(dump.first_line(port.samples))
            lines = dump.form(port.samples, both_stamps=port.link.both_stamps, fields=fields)
        return cls(port, layout, lines, None if fields is None else tuple(fields.values()))

    @property
    def clock(self) -> Reading:
        """The same without the values: counters and stamps alone."""
        return replace(self, lines=replace(self.lines, used=(), status=()))

    @property
    def scale(self) -> float:
        """What a logged number is times to be SI."""
        return np.pi / 180 if self.port.role == "joints" and self.layout.angle != "rad" else 1.0

    @property
    def name(self) -> str:
        """Name of the signal: that of its port, or the one given to a temperature."""
        titles = {given: title for title, given in self.layout.temperatures.items()}
        return titles.get(self.port.name, self.port.name)

    def signal(self, samples: dump.Samples) -> Signal:
        """Return some samples as a signal, repeated and disordered stamps included.

        Raises `LogError` where the layout names more or fewer columns than there are.
        """
        values, names = samples.values, self.titles if self.lines.width else ()
        if names is None:
            names = _names(self.port, len(self.lines.used), self.layout)
        used = [column for column, title in enumerate(names) if title]
        if len(used) < len(names):
            values, names = values[:, used], tuple(names[column] for column in used)
        return Signal(self.name, names, samples.stamps, values)

    def notes(
        self, ends: tuple[int, int] | None, packets: int, lost: tuple[int, int, int] | None
    ) -> list[Note]:
        """Return what is to be told of a folder besides repeated stamps.

        `ends` are its first and last stamp [ns], `lost` what `Counter.lost` says.
        """
        notes = []
        if ends is None:
            begin = min(self.port.link.opened, default=0)
            ends = begin, max(self.port.link.closed, default=begin)
            message = f"connected for {(ends[1] - begin) / NANOSECONDS:.1f} s but logged no sample"
            notes.append(Note("empty", self.name, *ends, message))
        if self.lines.truncated:
            message = "the last line is incomplete; left out"
            notes.append(Note("truncated", self.name, ends[1], ends[1] + 1, message))
        if lost:
            count, start, stop = lost
            message = f"the packet counter skips {count} of {count + packets} packets"
            notes.append(Note("lost packets", self.name, start, stop, message))
        return notes


def apart(sessions: Sequence[tuple[int, int, int]], ports: Sequence[Port]) -> None:
    """Raise `LogError` where sessions overlap in time, or differ in columns.

    Of each its first and last stamp [ns] and its number of columns, in the order of time.
    """
    folders = ", ".join(port.folder.name for port in ports)
    if any(later[0] <= earlier[1] for earlier, later in pairwise(sessions)):
        raise LogError(f"{ports[0].folder.parent}: sessions {folders} overlap in time; read one")
    if len({width for _, _, width in sessions}) > 1:
        raise LogError(f"{ports[0].folder.parent}: sessions {folders} differ in columns; read one")


def _join(sessions: Sequence[Signal]) -> Signal:
    """Return sessions of one port, ordered in time, as one signal with breaks between them."""
    first, *later = sessions
    return joined([first, *(replace(s, breaks=(0, *s.breaks)) for s in later)]) if later else first


def _names(port: Port, logged: int, layout: Layout) -> tuple[str, ...]:
    """Return a name for each of the `logged` columns of `port`, "" for those to leave out."""
    name = port.name
    match port.role:
        case "joints":
            said = layout.joints.get(name) or part_joints(name.partition("/")[0], logged)
            said = (*said, *("",) * (logged - len(said)))
        case "channels":
            plain = WRENCH_AXES if logged == 6 else tuple(f"ch{k}" for k in range(logged))
            said = layout.channels.get(name, plain)
        case "imus":
            plain = _INERTIAL if logged == 12 else tuple(f"c{k}" for k in range(logged))
            said = layout.imus.get(name, plain)
        case _:
            said = ("temperature",)
    if len(said) != logged:
        raise LogError(f"{port.samples}: {logged} columns but {len(said)} names;"
                       f" say in the job, as joints or channels, what {name!r} logs")  # fmt: skip
    return said
