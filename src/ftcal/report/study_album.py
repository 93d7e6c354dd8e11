"""The figures of a study's page with their captions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal import plots
from ftcal.contact import ContactSchedule
from ftcal.first_validation import TOGETHER, FirstValidation
from ftcal.plots.figure import HOLE
from ftcal.preparation import Prepared
from ftcal.report.album import THINNED, Album, Table
from ftcal.report.study_metrics import chosen_left
from ftcal.samples import Samples
from ftcal.second_validation import BEST, MIXED, WORKBENCH, SecondValidation
from ftcal.validate import HeldOut, held_out_samples

if TYPE_CHECKING:
    from ftcal.study import SensorStudy

SHOWN = 4
"""Matrices drawn in space at first; more hide one another, a click in the legend adds them."""


def space_figure(one: SensorStudy, takes: Mapping[str, Prepared], album: Album) -> Table:
    """Return the paper's first figure: the force of every matrix on one recording."""
    name, first, workbench = one.channel.sensor, one.first, one.channel.workbench
    label = shown_recording(name, first, takes)
    stretch = unbroken(max(takes[label].sensors[name].segments, key=len))
    read: dict[tuple[str, str], HeldOut] = {
        (training.recording, training.method): held_out_samples(
            stretch, found.coefficients, workbench
        )
        for training, found in zip(first.sets, first.estimates, strict=True)
    }
    readings = {key: piece.in_situ[:, :3] for key, piece in read.items()}
    readings = {(WORKBENCH, ""): next(iter(read.values())).workbench[:, :3]} | readings
    order = np.argsort(first.elsewhere())
    shown = {(first.sets[k].recording, first.sets[k].method) for k in order[: SHOWN - 1]}
    trained = label in {training.recording for training in first.sets}
    return album.add(
        plots.matrices_in_space(
            name, label, stretch.time, stretch.wrench[:, :3], readings, {*shown, (WORKBENCH, "")}
        ),
        f"Recording {label}, {stretch.start:.0f} to {stretch.stop:.0f} s"
        f" ({'one set trained on it' if trained else 'no set trained on it'}): force [N] at {name}"
        " as the robot model expects it (broad grey), as the Workbench reads it (dotted vermillion)"
        " and as the matrix of every training set does (solid: centred; dashed: in situ), each with"
        " the offset that fits best. A click in the legend shows or hides a matrix, drag to turn."
        " A regular selection of samples of its longest stretch without a pause.",
    )


def unbroken(segment: Samples) -> Samples:
    """Return the longest stretch without a pause: another contact is another cloud far away."""
    pause = np.diff(segment.time, prepend=segment.time[:1])
    cuts = np.flatnonzero(pause > HOLE * np.median(pause))
    run = max(np.split(segment.time, cuts), key=len)
    return segment.between(float(run[0]), float(np.nextafter(run[-1], np.inf)))


def shown_recording(sensor: str, first: FirstValidation, takes: Mapping[str, Prepared]) -> str:
    """Return the recording with the widest force at a sensor, best one that no set trained on."""
    trained = {training.recording for training in first.sets}
    choice = [name for name in first.recordings if name not in trained] or first.recordings

    def width(name: str) -> float:
        segments = takes[name].sensors[sensor].segments
        return max(float(segment.wrench[:, :3].var(axis=0).sum()) for segment in segments)

    return max(choice, key=width)


def axes_figure(one: SensorStudy, album: Album) -> Table:
    """Return the map of errors on data not trained on, axis by axis."""
    first = one.first
    names = ", ".join(first.judging)
    return album.add(
        plots.elsewhere_map(
            one.channel.sensor,
            [(training.recording, training.method) for training in first.sets],
            {group: first.elsewhere(group=group) for group in TOGETHER},
        ),
        f"Recordings {names}: mean over those that a set did not train on of its error"
        " [% of the Workbench's, sum |e|], a training set a column. Blue is better than the"
        " Workbench, vermillion and ▲ worse.",
    )


def leftover_figures(
    sensor: str, run: str, second: SecondValidation, schedule: ContactSchedule, album: Album
) -> list[Table]:
    """Return the paper's other two figures: Workbench against best, best against mixed."""
    left = chosen_left(second)
    made = []
    for below, above in ((WORKBENCH, BEST), (BEST, MIXED)):
        names: dict[str, Any] = {name: second.error[name] for name in (below, above)}
        made.append(
            album.add(
                plots.leftover_in_time(
                    f"External wrench that {sensor} sees, {below} and {above}: {run}",
                    second.time,
                    names,
                    schedule,
                ),
                f"Recording {run}: external force [N] and torque [Nm] that {sensor} sees, in its"
                f" own frame, in the sub-chain {second.sub_chain}, where nothing touches: it should"
                f" be zero. Mean length {left[below].force:.2f} N ({below}),"
                f" {left[above].force:.2f} N ({above}). Shaded by who touches the world; gaps are"
                " seconds in which the sub-chain is touched or a sensor was not usable." + THINNED,
            )
        )
    return made


def truth_figure(one: SensorStudy, distances: Mapping[str, Any], album: Album) -> Table:
    """Return the distances of all matrices to the true one."""
    names = ", ".join(dict.fromkeys(training.recording for training in one.first.sets))
    rows = [(name, 100.0 * value) for name, value in distances["sets"].items()]
    rows += [
        (words, 100.0 * distances[name])
        for name, words in ((BEST, "best of the 2nd validation"), (MIXED, "mixed"))
        if distances[name] is not None
    ]
    return album.add(
        plots.truth_distances(one.channel.sensor, 100.0 * distances[WORKBENCH], rows),
        f"Trained on {names}: RMS distance of the entries of each matrix to the true one"
        " [% of full scale]. The dotted line is the Workbench; squares are no nearer than it.",
    )
