"""How numbers and provenance stand in a text that a machine and a person read.

Numbers are the shortest that read back to the same float64. Provenance is two kinds of comment
line, `ftcal-provenance {...}` once and `ftcal-sensor {...}` a sensor, JSON after the first word.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np

from ftcal.errors import SensorError
from ftcal.export.installed import Installed, Sheet

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

FILE = "ftcal-provenance"
SENSOR = "ftcal-sensor"

CLOSERS = {"--": r"-\u002d", "*/": r"*\u002f", "/*": r"/\u002a"}
"""What would end or open a comment in XML or C, and the same as JSON escapes it in a text."""


def number(value: float) -> str:
    """Return the shortest text that reads back equal, always with a point.

    YAML 1.1 and YARP take `1e-05` for a word, ROS takes `2` for an integer.
    """
    mantissa, _, exponent = repr(float(value)).partition("e")
    whole = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{whole}e{exponent}" if exponent else whole


def row(values: Iterable[float], between: str = ", ") -> str:
    """Return numbers on one line."""
    return between.join(number(value) for value in values)


def numbers(text: str, count: int, where: str) -> Float[Array, "N"]:
    """Return the `count` numbers in a text, whatever stands between them.

    Raises `SensorError` for another count, or a word among them.
    """
    words = re.sub(r"[(){}\[\],;]", " ", text).split()
    try:
        found = np.array([float(word) for word in words])
    except ValueError as error:
        raise SensorError(f"{where}: {error}; take the file as it was written") from error
    if len(found) != count or not np.isfinite(found).all():
        raise SensorError(
            f"{where}: {len(found)} numbers where {count} finite ones belong; take the file as it"
            " was written"
        )
    return found


def provenance(sheet: Sheet) -> list[str]:
    """Return the comment lines that say where a file comes from."""
    return [
        f"{FILE} {as_comment(sheet.origin)}",
        *(f"{SENSOR} {as_comment(law.about)}" for law in sheet.sensors),
    ]


def as_comment(record: Any) -> str:
    """Return JSON on one line that ends no comment."""
    text = json.dumps(record, allow_nan=False)
    for closer, escaped in CLOSERS.items():
        text = text.replace(closer, escaped)
    return text


def told(text: str) -> dict[str, dict[str, Any]]:
    """Return the provenance of each sensor in a file, by name; empty for a file of others."""
    found = {}
    for line in re.findall(rf"{SENSOR} (\{{.*\}})", text):
        try:
            about = json.loads(line)
            found[str(about["sensor"])] = about
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise SensorError(f"comment {SENSOR!r}: {error!r}; delete the line") from error
    return found


def xml_root(content: bytes, where: str) -> Element:
    """Return the root of an XML file; `SensorError` where it is none, or has entities."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(content)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise SensorError(f"{where}: not XML that can be read ({error})") from error
    return root


def conventions(*lines: str) -> list[str]:
    """Return the lines that head every file: the law, then what `lines` add."""
    return [
        "Written by ftcal. Law: w = C r + o + k (T - T_ref), force [N] then torque [Nm].",
        *lines,
    ]


def raw_log(law: Installed) -> str:
    """Return the line about a log that carried channels for a file that takes wrenches."""
    name = "" if law.workbench is None else f" ({law.workbench.name})"
    return f"the log carried raw channels; the file is for a board that sends C_w r{name}"
