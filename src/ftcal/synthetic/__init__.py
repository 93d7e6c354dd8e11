"""A pretend robot, motions and sensors whose truth is known: test a motion before recording it.

    robot = read_robot("robot.urdf")
    pole = standing_on(FixedContact("root_link"))
    take = Take("grid", grid(robot, ["r_hip_pitch", "r_hip_roll"]), pole)
    sensors = {"r_leg_ft": "right_leg/analog:o"}
    session = simulate(robot, [take], sensors=sensors, generator=np.random.default_rng(1))
    job = write_session(session, Path("pretend"), urdf=Path("robot.urdf"))

then `ftcal calibrate pretend/job.toml`. The world is exactly the model, but for the `Faults` asked
for: what the calibration cannot find back, the motion did not show or the noise hid.
"""

from __future__ import annotations

from ftcal.synthetic.conditions import Conditions
from ftcal.synthetic.faults import Brush, Faults, OffsetStep, Saturation
from ftcal.synthetic.folder import TRUTH, Form, read_truth, write_session
from ftcal.synthetic.inertia import perturbed
from ftcal.synthetic.limbs import SideBySide
from ftcal.synthetic.load import felt
from ftcal.synthetic.sensor import PretendSensor, invent_firmware, mount
from ftcal.synthetic.session import SensorTruth, Session, simulate
from ftcal.synthetic.take import Take

__all__ = [
    "TRUTH",
    "Brush",
    "Conditions",
    "Faults",
    "Form",
    "OffsetStep",
    "PretendSensor",
    "Saturation",
    "SensorTruth",
    "Session",
    "SideBySide",
    "Take",
    "felt",
    "invent_firmware",
    "mount",
    "perturbed",
    "read_truth",
    "simulate",
    "write_session",
]
