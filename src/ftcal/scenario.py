"""The scenario file: which motions a pretend robot makes, with which sensors, and what goes wrong.

TOML like the job file: paths are relative to it, unknown keys are refused with the near name, all
faults of a file are reported at once. Lengths are in m, angles in rad where the key does not end in
`_deg`, seconds count from the start of each take.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError, model_validator

from ftcal.config import NotNegative, Positive, Section, in_words, read_toml
from ftcal.errors import JobError, raise_all
from ftcal.scenes import (
    AnyTake,
    BalancingTake,
    Finite,
    GridTake,
    LegSection,
    SoleSection,
    SwitchingTake,
    Whole,
)
from ftcal.synthetic import Brush, Conditions, Faults, Form, OffsetStep, Saturation

Part = Annotated[float, Field(ge=0, lt=1)]
Six = tuple[Finite, Finite, Finite, Finite, Finite, Finite]

USUAL, NONE = Conditions(), Faults()
"""Where the defaults of the sections stand."""


class SensorSection(Section):
    """One F/T sensor that is mounted, bent and logged."""

    name: str
    """Sensor of the URDF, or the fixed joint it sits in."""
    signal: str
    """Port of the log, such as `right_leg/analog:o`."""
    full_scale: tuple[Whole, Whole, Whole, Whole, Whole, Whole] | None = None
    """Largest wrench per axis, whole N and Nm; default: invented, of an iCub's size."""
    kappa: NotNegative | None = None
    """Its bend by mounting; default: that of `[conditions]`."""


class ConditionsSection(Section):
    """How imperfect sensors, encoders and clocks always are: `ftcal.synthetic.Conditions`."""

    kappa: NotNegative = USUAL.kappa
    noise: NotNegative = USUAL.noise
    offset: NotNegative = USUAL.offset
    digital: bool = USUAL.digital
    encoder: NotNegative = USUAL.encoder
    flicker: NotNegative = USUAL.flicker
    rate: Positive = USUAL.rate
    jitter: NotNegative = USUAL.jitter
    stagger: NotNegative = USUAL.stagger
    warming: Finite = USUAL.warming
    thermometer: bool = USUAL.thermometer


class SaturationSection(Section):
    """A sensor whose raw zero leaves one channel too little room."""

    sensor: str
    share: Part
    take: str | None = None


class StepSection(Section):
    """A sensor whose reading jumps."""

    sensor: str
    take: str
    start: Finite
    wrench: Six
    stop: Finite | None = None


class BrushSection(Section):
    """A frame that touches although the job says that it is free."""

    take: str
    frame: str
    start: Finite
    stop: Finite
    share: Part


class FaultsSection(Section):
    """What goes wrong: `ftcal.synthetic.Faults`."""

    saturation: tuple[SaturationSection, ...] = ()
    steps: tuple[StepSection, ...] = ()
    brushing: tuple[BrushSection, ...] = ()
    switch_share: Part = NONE.switch_share
    switch_seconds: NotNegative = NONE.switch_seconds
    delay: Finite = NONE.delay
    delays: dict[str, Finite] = Field(default_factory=dict)
    joint_zero: NotNegative = NONE.joint_zero
    mass: NotNegative = NONE.mass
    com: NotNegative = NONE.com


class Scenario(Section):
    """A whole scenario file."""

    robot: Path | None = None
    """URDF."""
    model: str | None = None
    """Or: a robot of the package icub-models."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of everything random."""
    format: Form = "yarp"
    """How recordings are written."""
    sensors: Annotated[tuple[SensorSection, ...], Field(min_length=1)]
    conditions: ConditionsSection = ConditionsSection()
    faults: FaultsSection = FaultsSection()
    takes: Annotated[tuple[AnyTake, ...], Field(min_length=1)]
    file: Annotated[Path, Field(exclude=True)] = Path("scenario.toml")
    """The scenario file itself (set by `read_scenario`)."""

    @model_validator(mode="after")
    def _one_robot(self) -> Scenario:
        if (self.robot is None) == (self.model is None):
            raise ValueError('give either robot = "FILE" or model = "NAME" (of icub-models)')
        names = [sensor.name for sensor in self.sensors]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"sensor {', '.join(map(repr, twice))} appears twice")
        return self

    def asked(self) -> Faults:
        """Return what is to go wrong."""
        section = self.faults
        kappa = {s.name: s.kappa for s in self.sensors if s.kappa is not None}
        lists = {"saturation", "steps", "brushing"}
        return Faults(
            kappa=kappa,
            saturation=tuple(Saturation(**s.model_dump()) for s in section.saturation),
            steps=tuple(OffsetStep(**s.model_dump()) for s in section.steps),
            brushing=tuple(Brush(**s.model_dump()) for s in section.brushing),
            **section.model_dump(exclude=lists),
        )


def read_scenario(path: Path) -> Scenario:
    """Return the scenario that a TOML file describes.

    Raises `JobError`, one line that names every fault with the near key where one is misspelt.
    """
    table = read_toml(path)
    if "file" in table:
        raise JobError(f"{path}: unknown key 'file'")
    try:
        return Scenario.model_validate({**table, "file": path})
    except ValidationError as error:
        faults = in_words(error.errors(), table, lambda parents: _keys(table, parents))
        raise_all(JobError, str(path), faults)
        raise


SECTIONS: Mapping[str, type[BaseModel]] = {
    "sensors": SensorSection,
    "conditions": ConditionsSection,
    "faults": FaultsSection,
    "saturation": SaturationSection,
    "steps": StepSection,
    "brushing": BrushSection,
    "sole": SoleSection,
    "left": LegSection,
    "right": LegSection,
    "grid": GridTake,
    "balancing": BalancingTake,
    "extended balancing": BalancingTake,
    "switching": SwitchingTake,
}
"""Section of each table of the file, and of each motion of a take."""


def _keys(table: Mapping[str, Any], parents: Iterable[Any]) -> list[str]:
    """Return the keys that the section at `parents` of a scenario file knows."""
    section: type[BaseModel] = Scenario
    node: Any = table
    for part in parents:
        node = node[part]
        motion = node.get("motion") if isinstance(node, dict) else None
        section = SECTIONS.get(str(part), SECTIONS.get(str(motion), section))
    return [name for name in section.model_fields if name != "file"]
