"""The embedded default: a session on a pretend iCub whose right hip sensor is bent, truth known.

Three takes as in the paper (section IV-C): a grid with the robot on a pole, a small and a wide
balancing motion on the left foot, and a second wide one that is held out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ftcal.errors import RobotError, unknown
from ftcal.motion import FixedContact
from ftcal.motions import balancing, extended_balancing, grid
from ftcal.robot import Robot
from ftcal.support import standing_on
from ftcal.synthetic import Conditions, Session, Take, simulate, write_session
from ftcal.urdf import read_robot

MODEL = "iCubGenova04"
"""Robot of the `icub-models` package."""

SENSOR, SIGNAL = "r_leg_ft", "right_leg/analog:o"
"""The hip sensor, and the port its readings are logged on."""

HIP = ("r_hip_pitch", "r_hip_roll", "r_hip_yaw")
LEG = (*HIP, "r_knee", "r_ankle_pitch", "r_ankle_roll")
SUPPORT = ("l_hip_pitch", "l_hip_roll", "l_knee", "l_ankle_pitch", "l_ankle_roll")


def icub_path(model: str = MODEL) -> Path:
    """Return the URDF of a robot of `icub-models`; `RobotError` says how to get it."""
    try:
        import icub_models
    except ImportError as error:
        raise RobotError(
            f"robot {model!r} is in the package icub-models: pip install 'ftcal[demo]'"
        ) from error
    known = icub_models.get_robot_names()
    if model not in known:
        raise RobotError(unknown("model", model, known))
    return Path(icub_models.get_model_file(model))


def demo_session(
    robot: Robot, generator: np.random.Generator, conditions: Conditions | None = None
) -> Session:
    """Return grid, balancing and extended balancing of the right leg, logged with one sensor."""
    pole, sole = (standing_on(FixedContact(name)) for name in ("root_link", "l_sole"))
    wide, wider = (
        extended_balancing(robot, LEG, generator=generator, support=SUPPORT) for _ in range(2)
    )
    takes = [
        Take("grid", grid(robot, HIP, points=(4, 4, 3), duration=140.0), pole),
        Take("balancing", balancing(robot, LEG, generator=generator, support=SUPPORT), sole),
        Take("extended_balancing", wide, sole),
        Take("extended_balancing_2", wider, sole, held_out=True),
    ]
    return simulate(
        robot,
        takes,
        sensors={SENSOR: SIGNAL},
        generator=generator,
        conditions=conditions,
    )


def write_demo(folder: Path, *, seed: int) -> Path:
    """Write the demo's logs, robot, matrix, truth and job into `folder`; return the job file."""
    urdf = icub_path()
    session = demo_session(read_robot(urdf), np.random.default_rng(seed))
    return write_session(session, folder / "session", urdf=urdf)
