"""One port of a YARP dump, all its sessions → one signal.

Sessions are connections noted in one `info.log`, or folders of one port that the dumper numbered
(`_00001`, …); between two of them the signal has a break.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
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


def read(root: Path, ports: Sequence[Port], layout: Layout) -> tuple[Streams, list[bytes]]:
    """Return the one signal of `ports`, the sessions of one port, and the SHA-256 of each file.

    Raises `LogError` where a session cannot be read, or two cannot be sessions of one port.
    """
    name = ports[0].name
    homes = {tuple(NUMBERED.sub("", p) for p in p.folder.relative_to(root).parts) for p in ports}
    if len(homes) > 1:
        where = ", ".join(str(port.folder) for port in ports[:2])
        raise LogError(f"{where}: both hold port {name!r}; read one recording at a time")
    notes: list[Note] = []
    sums: list[bytes] = []
    sessions: list[Signal] = []
    for port in ports:
        files = [f for f in (port.samples, port.folder / CONNECTION) if f.is_file()]
        with ThreadPoolExecutor(1) as beside:
            digests = beside.map(columns.file_sha256, files)
            signal, noticed = _session(port, layout)
        notes += noticed
        sums += digests
        if len(signal):
            sessions.append(signal)
    if not sessions:
        return Streams(notes=tuple(notes)), sums
    signal = _join(sorted(sessions, key=lambda s: int(s.stamps[0])), ports)
    if ports[0].role == MEASURES:
        return measures.split(signal, tuple(notes)), sums
    return Streams(notes=tuple(notes), **{ports[0].role: (signal,)}), sums


def _session(port: Port, layout: Layout) -> tuple[Signal, list[Note]]:
    """Return the samples of one folder as a signal, and what was noticed."""
    link = port.link
    scale = np.pi / 180 if port.role == "joints" and layout.angle != "rad" else 1.0
    samples, fields = dump.NOTHING, None
    if port.samples.is_file():
        if port.role == MEASURES:
            fields = measures.fields(dump.first_line(port.samples))
        samples = dump.parse(port.samples, both_stamps=link.both_stamps, scale=scale, fields=fields)
    values, names = samples.values, _names(port, samples.values.shape[1], layout)
    if fields is not None:
        names = tuple(fields.values()) if len(samples.stamps) else ()
    used = [column for column, title in enumerate(names) if title]
    if len(used) < len(names):
        values, names = values[:, used], tuple(names[column] for column in used)
    columns.require_finite(values, names, str(port.samples), first_row=1)
    signal = Signal(_title(port, layout), names, samples.stamps, values)
    signal, kept, noticed = columns.in_order(signal, str(port.samples), first_row=1)
    notes = list(noticed)
    begin = int(signal.stamps[0]) if len(signal) else min(link.opened, default=0)
    end = int(signal.stamps[-1]) if len(signal) else max(link.closed, default=begin)
    if not len(signal):
        message = f"connected for {(end - begin) / NANOSECONDS:.1f} s but logged no sample"
        notes.append(Note("empty", signal.name, begin, end, message))
    if samples.truncated:
        message = "the last line is incomplete; left out"
        notes.append(Note("truncated", signal.name, end, end + 1, message))
    breaks = dump.session_rows(signal.stamps, link)
    opening = np.searchsorted(samples.stamps, signal.stamps[list(breaks)])
    if lost := dump.lost_packets(samples.sequence, opening):
        count, before, after = lost
        message = f"the packet counter skips {count} of {count + len(kept)} packets"
        start, stop = int(samples.stamps[before]), int(samples.stamps[after])
        notes.append(Note("lost packets", signal.name, start, stop, message))
    return replace(signal, breaks=breaks), notes


def _join(sessions: Sequence[Signal], ports: Sequence[Port]) -> Signal:
    """Return sessions of one port, ordered in time, as one signal with breaks between them."""
    if len(sessions) == 1:
        return sessions[0]
    folders = ", ".join(port.folder.name for port in ports)
    if any(b.stamps[0] <= a.stamps[-1] for a, b in pairwise(sessions)):
        raise LogError(f"{ports[0].folder.parent}: sessions {folders} overlap in time; read one")
    if len({s.values.shape[1] for s in sessions}) > 1:
        raise LogError(f"{ports[0].folder.parent}: sessions {folders} differ in columns; read one")
    starts = np.cumsum([0, *(len(s) for s in sessions)])
    breaks = {b + int(o) for s, o in zip(sessions, starts, strict=False) for b in s.breaks}
    return replace(
        sessions[0],
        stamps=np.concatenate([s.stamps for s in sessions]),
        values=np.concatenate([s.values for s in sessions]),
        breaks=tuple(sorted(breaks | {int(start) for start in starts[1:-1]})),
    )


def _title(port: Port, layout: Layout) -> str:
    """Return the name of the signal of `port`: its own, or the one given to a temperature."""
    return {given: title for title, given in layout.temperatures.items()}.get(port.name, port.name)


def _names(port: Port, logged: int, layout: Layout) -> tuple[str, ...]:
    """Return a name for each of the `logged` columns of `port`, "" for those to leave out."""
    if not logged or port.role == MEASURES:
        return ()
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
