"""What users have: iDynTree asked sample by sample from Python.

The loops take motions and give wrenches as ftcal does, so that the numbers can be compared before
the clock starts. Arrays are laid out for iDynTree once a call, not once a sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import idyntree.bindings as idyn
import numpy as np

from ftcal.motion import STANDARD_GRAVITY, Motion

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Wrenches = dict[str, "Float[Array, 'N 6']"]
ExpectedLoop = Callable[[Motion], Wrenches]
TransformLoop = Callable[[Motion], "list[Float[Array, 'N 6 6']]"]
ExternalLoop = Callable[[Motion, Wrenches], "tuple[Wrenches, Float[Array, 'N J']]"]


def expected_loop(
    path: Path, contact: str, sensors: list[str], joints: tuple[str, ...]
) -> ExpectedLoop:
    """Return what its estimator expects of each of `sensors`, the contact link at rest."""
    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    estimator.setModel(loader.model())
    model = estimator.model()
    frame = model.getFrameIndex(contact)
    gravity = idyn.Vector3.FromPython(list(STANDARD_GRAVITY))
    unknowns = idyn.LinkUnknownWrenchContacts(model)
    unknowns.addNewUnknownFullWrenchInFrameOrigin(model, frame)
    readings = idyn.SensorsMeasurements(model.sensors())
    contacts = idyn.LinkContactWrenches(model)
    torques = idyn.JointDOFsDoubleArray(model)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    indices = [model.sensors().getSensorIndex(kind, name) for name in sensors]
    wrench = idyn.Wrench()
    order = [joints.index(model.getJointName(k)) for k in range(model.getNrOfDOFs())]

    def run(motion: Motion) -> Wrenches:
        q, dq, ddq = (
            np.ascontiguousarray(signal[:, order])
            for signal in (motion.position, motion.velocity, motion.acceleration)
        )
        results = {name: np.empty((len(motion), 6)) for name in sensors}
        for n in range(len(motion)):
            estimator.updateKinematicsFromFixedBase(
                idyn.JointPosDoubleArray.FromPython(q[n]),
                idyn.JointDOFsDoubleArray.FromPython(dq[n]),
                idyn.JointDOFsDoubleArray.FromPython(ddq[n]),
                frame,
                gravity,
            )
            estimator.computeExpectedFTSensorsMeasurements(unknowns, readings, contacts, torques)
            for name, index in zip(sensors, indices, strict=True):
                readings.getMeasurement(kind, index, wrench)
                results[name][n] = wrench.toNumPy()
        return results

    return run


def external_loop(
    path: Path, contact: str, sensors: list[str], links: list[str], joints: tuple[str, ...]
) -> ExternalLoop:
    """Return its estimate of the wrench at the origin of each of `links`, and of the torques."""
    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    estimator.setModel(loader.model())
    model = estimator.model()
    frame = model.getFrameIndex(contact)
    gravity = idyn.Vector3.FromPython(list(STANDARD_GRAVITY))
    unknowns = idyn.LinkUnknownWrenchContacts(model)
    indices = [model.getLinkIndex(name) for name in links]
    for name in links:
        unknowns.addNewUnknownFullWrenchInFrameOrigin(model, model.getFrameIndex(name))
    measured = idyn.SensorsMeasurements(model.sensors())
    contacts = idyn.LinkContactWrenches(model)
    torques = idyn.JointDOFsDoubleArray(model)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    channels = [model.sensors().getSensorIndex(kind, name) for name in sensors]
    order = [joints.index(model.getJointName(k)) for k in range(model.getNrOfDOFs())]
    back = np.argsort(order)

    def run(motion: Motion, readings: Wrenches) -> tuple[Wrenches, Float[Array, "N J"]]:
        q, dq, ddq = (
            np.ascontiguousarray(signal[:, order])
            for signal in (motion.position, motion.velocity, motion.acceleration)
        )
        wrenches = {name: np.empty((len(motion), 6)) for name in links}
        torque = np.empty((len(motion), len(order)))
        for n in range(len(motion)):
            estimator.updateKinematicsFromFixedBase(
                idyn.JointPosDoubleArray.FromPython(q[n]),
                idyn.JointDOFsDoubleArray.FromPython(dq[n]),
                idyn.JointDOFsDoubleArray.FromPython(ddq[n]),
                frame,
                gravity,
            )
            for name, channel in zip(sensors, channels, strict=True):
                measured.setMeasurement(kind, channel, idyn.Wrench.FromPython(readings[name][n]))
            estimator.estimateExtWrenchesAndJointTorques(unknowns, measured, contacts, torques)
            for name, index in zip(links, indices, strict=True):
                wrenches[name][n] = contacts.contactWrench(index, 0).contactWrench.toNumPy()
            torque[n] = torques.toNumPy()
        return wrenches, torque[:, back]

    return run


def transform_loop(
    path: Path, borders: Sequence[tuple[str, str, Float[Array, "4 4"]]], joints: tuple[str, ...]
) -> TransformLoop:
    """Return the wrench transforms from the sensor's frame to a link, for each of `borders`.

    A border is the link, the sensor's child link, and the sensor's pose in that.
    """
    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(path))
    kinematics = idyn.KinDynComputations()
    kinematics.loadRobotModel(loader.model())
    model = kinematics.model()
    order = [joints.index(model.getJointName(k)) for k in range(model.getNrOfDOFs())]
    ends = []
    for link, child, child_H_sensor in borders:
        rotation = idyn.Rotation.FromPython(child_H_sensor[:3, :3])
        place = idyn.Position.FromPython(child_H_sensor[:3, 3])
        frames = model.getFrameIndex(link), model.getFrameIndex(child)
        ends.append((*frames, idyn.Transform(rotation, place)))

    def run(motion: Motion) -> list[Float[Array, "N 6 6"]]:
        q = np.ascontiguousarray(motion.position[:, order])
        found = [np.empty((len(motion), 6, 6)) for _ in ends]
        for n in range(len(motion)):
            kinematics.setJointPos(idyn.VectorDynSize.FromPython(q[n]))
            for X, (link, child, child_H_sensor) in zip(found, ends, strict=True):
                pose = kinematics.getRelativeTransform(link, child) * child_H_sensor
                X[n] = pose.asAdjointTransformWrench().toNumPy()
        return found

    return run
