"""wholeBodyDynamics (robotology/whole-body-estimators): groups of its configuration, as XML.

The device computes, from the wrench m that the sensor's board sends,

    w = S m - offset + tc (T - T0)

(its `SixAxisForceTorqueMeasureProcessor`), with S from `FT_SECONDARY_CALIBRATION` (36 numbers, row
major), tc and T0 from `FT_TEMPERATURE_COEFFICIENTS` (6 + 1 numbers; where the sensor's temperature
is read), and the offset of `FT_OFFSET` (6 numbers), which it takes only once it is told
`usePreEstimatedOffset` over its RPC port; until then it has none, or that of its own `calib`. Our
law adds the offset, so FT_OFFSET = -o, tc = k and T0 = T_ref.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from ftcal.errors import SensorError
from ftcal.export.installed import Installed, Sheet, with_provenance
from ftcal.export.wording import conventions, numbers, provenance, raw_log, row, told, xml_root

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SECONDARY = "FT_SECONDARY_CALIBRATION"
OFFSET = "FT_OFFSET"
TEMPERATURE = "FT_TEMPERATURE_COEFFICIENTS"

HEAD = conventions(
    "Put the groups into the device `wholebodydynamics`, or include this file there (XInclude).",
    "The device computes w = S m - FT_OFFSET + tc (T - T0), m the wrench that the board sends:",
    "S = C C_w^-1 by rows; FT_OFFSET is minus o, used after the RPC command usePreEstimatedOffset;",
    "tc (6) and T0 are k and T_ref.",
)


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: all of it, on the wrench of the board."""
    return law.on("wrench")


def encode(sheet: Sheet) -> bytes:
    """Return the file. Raises `SensorError` for a sensor without six channels."""
    laws = [carried(law) for law in sheet.sensors]
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<!--"]
    lines += [f"  {line}" for line in (*HEAD, *provenance(sheet))]
    lines += ["-->", f'<params robot={quoteattr(str(sheet.origin["robot"]))} build="1">']
    lines += group(SECONDARY, {law.sensor: law.matrix for law in laws})
    lines += group(OFFSET, {law.sensor: 0.0 - law.offset for law in laws if law.offset.any()})
    warm = {
        law.sensor: np.append(law.temperature_gain, law.reference_temperature)
        for law in laws
        if law.temperature_gain is not None
    }
    return "\n".join([*lines, *group(TEMPERATURE, warm), "</params>", ""]).encode()


def group(name: str, values: dict[str, Float[Array, "..."]]) -> list[str]:
    """Return the lines of a group; none where it is empty."""
    if not values:
        return []
    lines = [f'  <group name="{name}">']
    for sensor, value in values.items():
        rows = f",\n{' ' * 7}".join(row(part) for part in np.atleast_2d(value))
        lines += [f"    <param name={quoteattr(sensor)}>", f"      ({rows})", "    </param>"]
    return [*lines, "  </group>"]


def decode(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensors of a configuration file of the device, ours or another's.

    Raises `SensorError`: no XML, no secondary matrices, wrong counts.
    """
    root = xml_root(content, where)
    abouts = told(content.decode("utf-8", errors="replace"))
    read = {
        name: {
            str(param.get("name")): numbers(param.text or "", count, f"{where}: {name}")
            for found in root.iter("group")
            if found.get("name") == name
            for param in found.iter("param")
        }
        for name, count in ((SECONDARY, 36), (OFFSET, 6), (TEMPERATURE, 7))
    }
    if not read[SECONDARY]:
        raise SensorError(f"{where}: no group {SECONDARY}; give the file of wholeBodyDynamics")
    laws = []
    for sensor, matrix in read[SECONDARY].items():
        offset = 0.0 - read[OFFSET].get(sensor, np.zeros(6))
        law = Installed(sensor, "wrench", matrix.reshape(6, 6), offset)
        if (warm := read[TEMPERATURE].get(sensor)) is not None:
            law = replace(law, temperature_gain=warm[:6], reference_temperature=float(warm[6]))
        laws.append(with_provenance(law, abouts.get(sensor)))
    return tuple(laws)


def remarks(law: Installed) -> list[str]:
    """Return what a person must know before the file is used."""
    lines = []
    if law.offset.any():
        lines.append("FT_OFFSET holds -o; the device uses it after RPC usePreEstimatedOffset")
    if law.workbench is not None and law.workbench.logged == "channels":
        lines.append(raw_log(law))
    return lines
