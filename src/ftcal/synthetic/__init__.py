"""A pretend robot, motions and sensors whose truth is known: test a motion before recording it.

    robot = read_robot("robot.urdf")
    take = Take("grid", grid(robot, ["r_hip_pitch", "r_hip_roll"]), FixedContact("root_link"))
    session = simulate(robot, [take], sensor="r_leg_ft", generator=np.random.default_rng(1))
    job = write_session(session, Path("pretend"), urdf=Path("robot.urdf"))

then `ftcal calibrate pretend/job.toml`. The world is exactly the model: what the calibration cannot
find back, the motion did not show or the noise hid.
"""

from __future__ import annotations

from ftcal.synthetic.folder import read_truth, write_session
from ftcal.synthetic.logger import Conditions, Take
from ftcal.synthetic.sensor import PretendSensor, invent_firmware, mount
from ftcal.synthetic.session import SensorTruth, Session, simulate

__all__ = [
    "Conditions",
    "PretendSensor",
    "SensorTruth",
    "Session",
    "Take",
    "invent_firmware",
    "mount",
    "read_truth",
    "simulate",
    "write_session",
]
