"""ROS 2 parameters of `force_torque_sensor_broadcaster` (ros2_controllers), one a sensor.

The broadcaster publishes, of each axis alone, `multiplier (x + offset)`, offset first (parameters
`offset.force.x` … and, in newer releases, `multiplier.force.x` …), then hands the wrench to
`sensor_filter_chain`. The multipliers are the diagonal of S, the offsets `o_i / S_ii`, moved so
that the middle of the loads of training reads right; the rest of the crosstalk is lost, and
`remarks` says how much that is. None of the filters that come with ROS
(`control_filters`: low pass, exponential, rate limit, gravity compensation) applies a 6x6, so the
whole law stands beside: a second broadcaster, `SENSOR_law`, whose chain is one filter that the user
builds from the source in `docs/export.md`.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import SensorError
from ftcal.export.installed import Installed, Sheet, identifier, with_provenance
from ftcal.export.wording import conventions, number, provenance, raw_log, row, told
from ftcal.sensor import AXES, UNITS

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BROADCASTER = "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster"
PARAMETERS = "ros__parameters"
LAW = "_law"
FILTER = "wrench_law/WrenchLawFilter"

HEAD = conventions(
    "The broadcaster publishes multiplier * (x + offset) per axis: x is what the driver sends, the",
    "multiplier the diagonal of S = C C_w^-1. Crosstalk, the rest of S, is lost that way; so is k.",
    "The offset is right in the middle of the loads that training saw.",
    "SENSOR_law is a broadcaster of the whole law, w = matrix x + offset, matrix by rows: spawn it",
    "instead, take ~/wrench_filtered. No filter that comes with ROS 2 applies a 6x6: build",
    "wrench_law/WrenchLawFilter from its source in docs/export.md of ftcal. It does not use k.",
)


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: all of it, on the wrench that the driver sends."""
    return law.on("wrench")


def encode(sheet: Sheet) -> bytes:
    """Return the parameter file. `SensorError`: not six channels, or a diagonal entry of 0."""
    tree: dict[str, Any] = {
        "controller_manager": {
            PARAMETERS: {
                f"{identifier(law.sensor)}{kind}": {"type": BROADCASTER}
                for law in sheet.sensors
                for kind in ("_broadcaster", LAW)
            }
        }
    }
    for law in sheet.sensors:
        name = identifier(law.sensor)
        tree[f"{name}_broadcaster"] = {PARAMETERS: broadcaster(law)}
        tree[f"{name}{LAW}"] = {PARAMETERS: whole(law)}
    comments = [f"# {line}" for line in (*HEAD, *provenance(sheet))]
    return "\n".join([*comments, *block(tree), ""]).encode()


def broadcaster(law: Installed) -> dict[str, Any]:
    """Return the parameters of one broadcaster."""
    held = carried(law)
    multiplier = np.diag(held.matrix)
    if not multiplier.all():
        axis = AXES[int(np.argmin(np.abs(multiplier)))]
        raise SensorError(f"sensor {law.sensor!r}: S has 0 on the diagonal of {axis}; use --to c")
    offset = held.offset
    if offset.any():
        # what the crosstalk does in the middle of the loads is an offset too
        offset = offset - crosstalk(np.diag(multiplier), law)[0]
    return {
        **named(law),
        "offset": by_axis(offset / multiplier),
        "multiplier": by_axis(multiplier),
    }


def whole(law: Installed) -> dict[str, Any]:
    """Return the parameters of a broadcaster with the whole law in its chain."""
    held = carried(law)
    params: dict[str, Any] = {"matrix": held.matrix.ravel(), "offset": held.offset}
    if held.temperature_gain is not None:
        params["temperature_gain"] = held.temperature_gain
        params["reference_temperature"] = held.reference_temperature
    chain = {"filter1": {"name": "law", "type": FILTER, "params": params}}
    return {**named(law), "sensor_filter_chain": chain}


def named(law: Installed) -> dict[str, Any]:
    """Return the parameters that say whose wrench it is."""
    frame = str((law.about or {}).get("frame", law.sensor))
    # an origin that is no link is published under the sensor's name
    return {
        "sensor_name": law.sensor,
        "frame_id": law.sensor if frame.endswith(" (origin)") else frame,
    }


def by_axis(values: Float[Array, "6"]) -> dict[str, dict[str, float]]:
    """Return six values under the names of the broadcaster."""
    force, torque = (dict(zip("xyz", part, strict=True)) for part in (values[:3], values[3:]))
    return {"force": force, "torque": torque}


def block(tree: dict[str, Any], deep: int = 0) -> list[str]:
    """Return a tree as lines of YAML: names by indentation, values as JSON writes them."""
    lines = []
    for name, value in tree.items():
        head = f"{'  ' * deep}{name}:"
        if isinstance(value, dict):
            lines += [head, *block(value, deep + 1)]
        elif isinstance(value, str):
            lines.append(f"{head} {json.dumps(value)}")
        elif np.ndim(value):
            lines.append(f"{head} [{row(value)}]")
        else:
            lines.append(f"{head} {number(value)}")
    return lines


def parsed(text: str, where: str) -> dict[str, Any]:
    """Return the tree in the YAML that `block` writes; `SensorError` for any other YAML."""
    root: dict[str, Any] = {}
    levels = [root]
    for count, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        indent = len(line) - len(line.lstrip(" "))
        name, colon, value = line.strip().partition(":")
        if not colon or indent % 2 or indent // 2 >= len(levels):
            raise SensorError(f"{where}: line {count} is no `name: value` as ftcal writes them")
        del levels[indent // 2 + 1 :]
        if value.strip():
            try:
                levels[-1][name] = json.loads(value)
            except (ValueError, RecursionError) as error:
                raise SensorError(f"{where}: line {count}: {error}") from error
        else:
            levels.append(levels[-1].setdefault(name, {}))
    return root


def decode(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the whole laws in a parameter file of ours; `SensorError` where it has none."""
    text = content.decode("utf-8", errors="replace")
    abouts, laws = told(text), []
    for name, node in parsed(text, where).items():
        if not name.endswith(LAW):
            continue
        try:
            sensor = str(node[PARAMETERS]["sensor_name"])
            held = node[PARAMETERS]["sensor_filter_chain"]["filter1"]["params"]
            warm = held.get("temperature_gain")
            law = Installed(
                sensor,
                "wrench",
                np.array(held["matrix"], dtype=np.float64).reshape(6, 6),
                np.array(held["offset"], dtype=np.float64).reshape(6),
                None if warm is None else np.array(warm, dtype=np.float64).reshape(6),
                float(held.get("reference_temperature", 0.0)),
            )
            laws.append(with_provenance(law, abouts.get(sensor)))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise SensorError(
                f"{where}: {name}: {error}; take the file as ftcal wrote it"
            ) from error
    if not laws:
        raise SensorError(f"{where}: no block *{LAW}; give a parameter file that ftcal wrote")
    return tuple(laws)


def crosstalk(
    S: Float[Array, "6 6"], law: Installed
) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """Return the error of `S x + o` in the middle of the loads of training, and its swing [N, Nm].

    The law is right: x = S_law^-1 (w - o), so the error is `(S - S_law) S_law^-1 (w - o)`. It is
    linear in w: over the box of loads it stays within middle +- swing.
    """
    held = carried(law)
    box = np.array([(law.about or {})["envelope"][axis] for axis in AXES])
    A = (S - held.matrix) @ np.linalg.inv(held.matrix)
    middle, half = box.mean(axis=1), (box[:, 1] - box[:, 0]) / 2
    return A @ (middle - held.offset), np.abs(A) @ half


def remarks(law: Installed) -> list[str]:
    """Return what the multipliers lose, what the Workbench would, and what has no place."""
    _, alone = crosstalk(np.diag(np.diag(carried(law).matrix)), law)
    _, before = crosstalk(np.eye(6), law)
    said = [
        f"{axis} {value:.2g} ({other:.2g}) {unit}"
        for axis, value, other, unit in zip(AXES, alone, before, UNITS, strict=True)
    ]
    lines = [
        "multipliers alone are off, within the loads of training and tared in their middle, by up"
        f" to (Workbench alone): {', '.join(said)}"
    ]
    if law.temperature_gain is not None:
        warm = f"{law.reference_temperature:g} degree Celsius"
        lines.append(
            f"the broadcaster has no temperature term: right at {warm}; k is in _law alone"
        )
    if law.workbench is not None and law.workbench.logged == "channels":
        lines.append(raw_log(law))
    return lines
