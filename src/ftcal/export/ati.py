"""`FTxxxxx.cal` of ATI Industrial Automation: the matrix of a sensor with 6 to 8 gauges, as XML.

A `UserAxis` row is force or torque per gauge unit, and ATI's library computes `w = M (v - bias)`.
Its C library (1.0) takes `Axis` rows divided by their `scale`, moved by `BasicTransform`; here both
are the same rows: scale 1, no transform. The bias is taken by the user's software and has no place
in the file: v = bias must read zero, so `M bias = -o`, which a comment gives. Hardware facts of the
maker's file (OutputMode, OutputRange, Thermistor, slopes) are not known here and left out.
"""

from __future__ import annotations

from dataclasses import replace
from xml.sax.saxutils import quoteattr

import numpy as np

from ftcal.errors import SensorError, raise_all
from ftcal.export.installed import Installed, Sheet, identifier, with_provenance
from ftcal.export.wording import conventions, number, numbers, provenance, row, told, xml_root

NAMES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
MOST = 8
"""Gauges that ATI's C library has room for (MAX_GAUGES)."""

TORQUE = {"N-m": 1.0, "Nm": 1.0, "N-mm": 1e-3}
"""Newton metres in a unit of torque that `.cal` files name."""


def file_name(law: Installed) -> str:
    """Return the usual name, with the sensor's for the serial number."""
    return f"FT_{identifier(law.sensor)}.cal"


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: the matrix on raw channels."""
    return replace(law.on("channels"), offset=np.zeros(6), temperature_gain=None)


def encode(sheet: Sheet) -> bytes:
    """Return the file of one sensor; `SensorError` for more than eight channels."""
    (law,) = sheet.sensors
    C, channels = carried(law).matrix, law.matrix.shape[1]
    if channels > MOST:
        raise SensorError(f"sensor {law.sensor!r}: {channels} channels, .cal files have {MOST}")
    scale = np.zeros(6) if law.full_scale is None else law.full_scale
    rows = [
        f"Name={quoteattr(name)} values={quoteattr(row(values, ' '))} max={quoteattr(number(most))}"
        for name, values, most in zip(NAMES, C, scale, strict=True)
    ]
    head = conventions(
        "UserAxis: N and Nm per unit of the log's raw channel; w = M (v - bias).",
        f"The offset as a bias: {' '.join(f'{value:.7g}' for value in bias(law))}",
    )
    lines = ['<?xml version="1.0" encoding="utf-8"?>', "<!--"]
    lines += [f"  {line}" for line in (*head, *provenance(sheet))]
    lines += [
        "-->",
        f'<FTSensor Serial={quoteattr(law.sensor)} BodyStyle="unknown" Family="DAQ"'
        f' NumGages="{channels}" CalFileVersion="1.1">',
        f'  <Calibration PartNumber="ftcal" CalDate={quoteattr(str(sheet.origin["created"]))}'
        ' ForceUnits="N" TorqueUnits="N-m" DistUnits="m">',
        *(f'    <Axis {attributes} scale="1"/>' for attributes in rows),
        '    <BasicTransform Dx="0" Dy="0" Dz="0" Rx="0" Ry="0" Rz="0"/>',
        *(f"    <UserAxis {attributes}/>" for attributes in rows),
        "  </Calibration>",
        "</FTSensor>",
        "",
    ]
    return "\n".join(lines).encode()


def decode(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensor of a `.cal` file with `UserAxis` rows, ours or ATI's own, in N and Nm.

    Raises `SensorError`: not XML, an axis missing, other units than N and N-m or N-mm.
    """
    root = xml_root(content, where)
    part = root.find("Calibration")
    gauges = root.get("NumGages", "")
    if part is None or not (gauges.isdecimal() and 0 < int(gauges) <= MOST):
        raise SensorError(f"{where}: no Calibration of 1 to {MOST} gauges; give a .cal file of ATI")
    force, torque = part.get("ForceUnits"), part.get("TorqueUnits", "")
    rows = {axis.get("Name"): axis.get("values", "") for axis in part.iter("UserAxis")}
    faults = [f"no UserAxis {name!r}" for name in NAMES if name not in rows]
    if force != "N" or torque not in TORQUE:
        faults.append(f"units {force!r} and {torque!r}; have it in N and N-m or N-mm")
    raise_all(SensorError, where, faults)
    units = np.repeat([1.0, TORQUE[torque]], 3)
    C = np.stack([numbers(rows[name], int(gauges), f"{where}: {name}") for name in NAMES])
    about = next(iter(told(content.decode("utf-8", errors="replace")).values()), None)
    law = Installed(str(root.get("Serial")), "channels", C * units[:, None], np.zeros(6))
    return (with_provenance(law, about),)


def bias(law: Installed) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the smallest v with `C v = -o` [gauge units]: the reading of no load."""
    C = law.on("channels").matrix
    return np.asarray(np.linalg.lstsq(C, 0.0 - law.offset, rcond=None)[0] + 0.0)


def remarks(law: Installed) -> list[str]:
    """Return what the file leaves out."""
    lines = []
    if law.offset.any():
        lines.append(
            "a .cal file has no offset: o stands as a bias in a comment, software takes it"
        )
    if law.temperature_gain is not None:
        lines.append("k on wrenches has no place in a .cal file: left out")
    return lines
