"""A C99 header: the numbers of each sensor and one function that applies them.

`SENSOR_wrench(x, w)` computes `w = M x + o + k (T - T_ref)`. x is what the log carried, so what the
robot's driver delivers: the Workbench's wrench (M is S), or raw channels (M is C). Reference
temperature and k are there, and T an argument, only where the calibration has them.
"""

from __future__ import annotations

import re

import numpy as np

from ftcal.errors import SensorError
from ftcal.export.installed import Installed, Reads, Sheet, identifier, with_provenance
from ftcal.export.wording import conventions, number, numbers, provenance, row, told

HEAD = conventions(
    "SENSOR_wrench(x, w) computes w = M x + o, and + k (T - T_ref) where SENSOR_per_kelvin stands."
)
SAID: dict[Reads, str] = {
    "wrench": "x: wrench as the sensor's board sends it, C_w r [N, Nm]; M is S = C C_w^-1",
    "channels": "x: raw channels r as logged; M is C",
}
APPLY = """static inline void {name}_wrench(const double x[{K}]{argument}, double w[6])
{{
  for (int i = 0; i < 6; ++i) {{
    w[i] = {name}_offset[i]{warm};
    for (int j = 0; j < {K}; ++j)
      w[i] += {name}_matrix[i][j] * x[j];
  }}
}}"""


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: all of it, on what the log carried."""
    wrench = law.workbench is not None and law.workbench.logged == "wrench"
    return law.on("wrench" if wrench else "channels")


def encode(sheet: Sheet) -> bytes:
    """Return the header of all sensors."""
    guard = f"FTCAL_{identifier(str(sheet.origin['robot'])).upper()}_H"
    lines = ["/*", *(f" * {line}" for line in (*HEAD, *provenance(sheet))), " */"]
    lines += [f"#ifndef {guard}", f"#define {guard}"]
    for law in sheet.sensors:
        lines += ["", *sensor(carried(law))]
    return "\n".join([*lines, "", f"#endif /* {guard} */", ""]).encode()


def sensor(law: Installed) -> list[str]:
    """Return the lines of one sensor."""
    name, K = identifier(law.sensor), law.matrix.shape[1]
    rows = ",\n".join(f"  {{{row(values)}}}" for values in law.matrix)
    lines = [
        f"/* {SAID[law.reads]} */",
        f"static const double {name}_matrix[6][{K}] = {{\n{rows}}};",
        f"static const double {name}_offset[6] = {{{row(law.offset)}}};",
    ]
    argument = warm = ""
    if law.temperature_gain is not None:
        lines += [
            f"static const double {name}_per_kelvin[6] = {{{row(law.temperature_gain)}}};",
            f"static const double {name}_reference_temperature = "
            f"{number(law.reference_temperature)};",
        ]
        argument = ", double temperature"
        warm = f" + {name}_per_kelvin[i] * (temperature - {name}_reference_temperature)"
    return [*lines, APPLY.format(name=name, K=K, argument=argument, warm=warm)]


def decode(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensors of a header of ours; `SensorError` where it is none."""
    text = content.decode("utf-8", errors="replace")
    abouts = {identifier(name): about for name, about in told(text).items()}
    laws = []
    for name, K in re.findall(r"static const double (\w+)_matrix\[6\]\[(\d+)\] =", text):
        about = abouts.get(name)
        if about is None:
            raise SensorError(f"{where}: no comment says what {name} is; give a header of ftcal")
        M = values(text, f"{name}_matrix[6][{K}]", 6 * int(K), where)
        warm = f"{name}_per_kelvin[6]" in text
        law = Installed(
            name,
            "wrench" if about.get("logged") == "wrench" else "channels",
            M.reshape(6, int(K)),
            values(text, f"{name}_offset[6]", 6, where),
            values(text, f"{name}_per_kelvin[6]", 6, where) if warm else None,
            float(values(text, f"{name}_reference_temperature", 1, where)[0]) if warm else 0.0,
        )
        laws.append(with_provenance(law, about))
    if not laws:
        raise SensorError(f"{where}: no NAME_matrix[6][K]; give a header that ftcal wrote")
    return tuple(laws)


def values(
    text: str, name: str, count: int, where: str
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the numbers that a constant of the header is set to."""
    found = re.search(rf"static const double {re.escape(name)} = ([^;]*);", text)
    return np.asarray(numbers(found.group(1) if found else "", count, f"{where}: {name}"))


def remarks(law: Installed) -> list[str]:
    """Return what the caller must know."""
    return [f"{identifier(law.sensor)}_wrench, {SAID[carried(law).reads]}"]
