"""A recording → the folders that a YARP dumper would have written.

For `ftcal simulate`: what comes out is read by every tool that reads an iCub's own logs. The
format keeps microseconds and six decimals of N, Nm and degrees, no more.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.dump import CONNECTION, SAMPLES, SEQUENCE_SIZE
from ftcal.logs.layout import Layout, part_joints
from ftcal.recording import Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

_POSITION_MODE = int.from_bytes(b"pos", "little")  # a YARP vocab is its letters as an integer
_STIFF = int.from_bytes(b"stif", "little")


def write(recording: Recording, root: Path, *, robot: str = "icub") -> Layout:
    """Write `recording` as `<root>/<robot>/<part>/<port>/` and return the layout that reads it.

    A signal whose name ends in no known port gets one: `l_leg` becomes `l_leg/analog:o`. Joints go
    out in degrees; `stateExt:o` has ten groups, of which all but the positions are zero.
    """
    home = root / robot
    joints = {}
    for signal in recording.joints:
        port = _port(signal.name, ("state:o", "stateExt:o"), "stateExt:o")
        if part_joints(port.partition("/")[0], len(signal.columns)) != signal.columns:
            joints[port] = signal.columns
        line = _extended_state if port.endswith("stateExt:o") else _plain
        _write(home, port, signal, line(np.rad2deg(signal.values)))
    channels, imus, temperatures = {}, {}, {}
    for signal in recording.channels:
        port = _port(signal.name, ("analog:o",), "analog:o")
        channels[port] = signal.columns
        _write(home, port, signal, _plain(signal.values))
    for signal in recording.temperatures:
        port = _port(signal.name, ("temperature:o",), "temperature:o")
        temperatures[signal.name] = port
        _write(home, port, signal, _plain(signal.values))
    for signal in recording.imus:
        port = _port(signal.name, ("inertial",), "inertial")
        imus[port] = signal.columns
        _write(home, port, signal, _plain(signal.values))
    return Layout(joints=joints, channels=channels, temperatures=temperatures, imus=imus)


def _port(name: str, endings: tuple[str, ...], ending: str) -> str:
    return name if name.rpartition("/")[2] in endings else f"{name}/{ending}"


def _plain(values: Float[Array, "N K"]) -> list[str]:
    row = " ".join(["%.6f"] * values.shape[1])
    return [row % tuple(numbers) for numbers in values.tolist()]


def _extended_state(degrees: Float[Array, "N K"]) -> list[str]:
    def group(number: object) -> str:
        return f"({' '.join([str(number)] * degrees.shape[1])}) [ok]"

    rest = " ".join([*[group(0.0)] * 7, group(_POSITION_MODE), group(_STIFF)])
    return [f"({row}) [ok] {rest}" for row in _plain(degrees)]


def _write(home: Path, port: str, signal: Signal, rows: list[str]) -> None:
    """Write the folder of `port`; one that logged nothing has no connection to tell of either."""
    folder = home / port
    folder.mkdir(parents=True, exist_ok=True)
    stamps = [_seconds(stamp) for stamp in signal.stamps.tolist()]
    events = [
        f"[{stamps[row]}] /{home.name}/{port} [{event}]"
        for first, stop in pairwise([0, *signal.breaks, len(stamps)] if stamps else [])
        for row, event in ((first, "connected"), (stop - 1, "disconnected"))
    ]
    lines = [
        f"{number % SEQUENCE_SIZE} {stamp} {row}\n"
        for number, (stamp, row) in enumerate(zip(stamps, rows, strict=True))
    ]
    (folder / SAMPLES).write_text("".join(lines), encoding="ascii", newline="\n")
    text = "\n".join(["Type: Bottle;", "Stamp: tx;", *events, ""])
    (folder / CONNECTION).write_text(text, encoding="utf-8", newline="\n")


def _seconds(stamp: int) -> str:
    microseconds = (stamp + 500) // 1000
    return f"{microseconds // 1_000_000}.{microseconds % 1_000_000:06d}"
