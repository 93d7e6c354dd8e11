"""YARP dumper folders: one folder a port, as the iCub logs itself.

Both layouts are read: the tree `<root>/icub/<part>/<port>/` and one flat folder a port. Names come
from `info.log` without the robot's: `/icub/right_leg/analog:o` is `right_leg/analog:o`; where it is
silent, from the folder. A folder whose name ends in `_00001`, … is a later session of its port.

| port | becomes | unit |
|---|---|---|
| `<part>/state:o`, `<part>/stateExt:o` | joints, first group = positions | deg → rad |
| `…/analog:o` | F/T channels, exactly as logged | N, Nm, or counts |
| `…/temperature:o` | temperature | as logged |
| `…/measures:o` | F/T channels, temperatures, imus, by its nested lists | as logged |
| `…/inertial…` | imus, exactly as logged | deg, m/s^2, deg/s, … |

Ports of other names are left alone unless the layout names them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ftcal.errors import LogError, unknown
from ftcal.logs import columns, dump, measures, port
from ftcal.logs.dump import CONNECTION, SAMPLES
from ftcal.logs.layout import Layout
from ftcal.logs.port import MEASURES, NUMBERED, Port
from ftcal.logs.yarp_writer import write
from ftcal.recording import Recording

__all__ = ["SAMPLES", "holds", "read", "write"]


def holds(path: Path) -> bool:
    """Return whether a dumper left a log in the folder `path` or below."""
    return any(next(path.rglob(name), None) is not None for name in (SAMPLES, CONNECTION))


def ports(path: Path, layout: Layout) -> tuple[list[list[Port]], list[str]]:
    """Return the sessions of every port below `path` that is to be read, and all names of ports.

    Raises `LogError` where nothing says what a folder holds, the layout names a port that is not
    there, or no folder holds a sample.
    """
    folders = sorted({log.parent for f in (SAMPLES, CONNECTION) for log in path.rglob(f)})
    logged = {f for f in folders if (f / SAMPLES).is_file() and (f / SAMPLES).stat().st_size}
    if not logged:
        raise LogError(f"{path}: no samples in any data.log; give the folder that the dumper wrote")
    every = [_open(folder, layout) for folder in folders]
    known = {port.name for port in every}
    wanted = (*layout.joints, *layout.channels, *layout.imus, *layout.temperatures.values())
    if absent := [name for name in wanted if name not in known]:
        raise LogError(f"{path}: {unknown('port', absent[0], known)}; the layout must name one")
    fuller = {p.name.removesuffix("stateExt:o") for p in every
              if p.folder in logged and p.name.endswith("stateExt:o")}  # fmt: skip
    sessions: dict[str, list[Port]] = {}
    for p in every:
        # a board's state:o and stateExt:o say the same positions
        if p.role and not (
            p.name.endswith("/state:o") and p.name.removesuffix("state:o") in fuller
        ):
            sessions.setdefault(p.name, []).append(p)
    return list(sessions.values()), sorted(known)


def read(path: Path, layout: Layout, *, name: str | None = None) -> Recording:
    """Return the recording below the folder `path`: a root, its `icub` folder, or one port.

    Raises `LogError` where a known port cannot be read, or the layout names a port that is not
    there. A port that was connected but logged nothing is a finding.
    """
    groups, known = ports(path, layout)
    parts, sums = [], []
    for sessions in groups:
        streams, digests = port.read(path, sessions, layout)
        parts.append(streams)
        sums += digests
    if not any(part.signals for part in parts):
        raise nothing(path, known)
    return columns.recording(
        columns.merge(parts),
        name=name or path.resolve().name,
        source=str(path),
        zero=layout.zero,
        sha256=columns.digest(sums),
    )


def nothing(path: Path, known: Sequence[str]) -> LogError:
    """Return the error that names the ports `known` below `path`, of which none gave a signal."""
    return LogError(
        f"{path}: no joint, F/T or inertial sample (ports: {', '.join(known)});"
        " name those to use in the job, as joints or channels"
    )


def _open(folder: Path, layout: Layout) -> Port:
    """Return the port in `folder`; `LogError` where numbers are there but nothing says of what."""
    file, log = folder / CONNECTION, folder / SAMPLES
    text = file.read_bytes() if file.is_file() else b""
    link = dump.connection(text, str(file))
    name = _name(folder, link.port)
    role = _role(name, layout) if link.bottle else ""
    if role == MEASURES and log.is_file() and not measures.fields(dump.first_line(log)):
        role = ""  # encoders, skin: nothing that is read
    if link.bottle and not (role or link.port) and log.is_file() and dump.numeric(log):
        raise LogError(f"{folder}: no info.log says what port {name!r} is;"
                       " name it in the job as joints or channels")  # fmt: skip
    return Port(folder, name, role, link)


def _name(folder: Path, port: str) -> str:
    """Return the port without the robot's name, else the end of the folder's path that says it."""
    parts = [part for part in port.split("/") if part]
    if parts:
        return "/".join(parts[1:] or parts)
    parts = [NUMBERED.sub("", part) for part in folder.resolve().parts]
    if len(parts) > 2 and parts[-1] == "data":  # <port>/data_00001
        parts.pop()
    return "/".join(parts[-2:] if ":" in parts[-1] else parts[-1:])


def _role(name: str, layout: Layout) -> str:
    """Return the field of `Streams` that the port `name` fills, "" for none."""
    said = {"joints": layout.joints, "channels": layout.channels, "imus": layout.imus,
            "temperatures": layout.temperatures.values()}  # fmt: skip
    for role, names in said.items():
        if name in names:
            return role
    ending = name.rpartition("/")[2]
    habits = {"state:o": "joints", "stateExt:o": "joints", "analog:o": "channels",
              "temperature:o": "temperatures", "measures:o": MEASURES}  # fmt: skip
    return "imus" if ending.startswith("inertial") else habits.get(ending, "")
