"""A fit of all sensors → one page of HTML: verdicts, the robot, then a section for each sensor.

Here are the words and the numbers; `ftcal/templates/whole.html` has the order and the looks.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ftcal import plots
from ftcal.judging import SensorResult, loose_scales
from ftcal.report.album import Album, Table, residual_figures
from ftcal.report.page import health_section, matrices, table_of
from ftcal.report.rendering import rendered
from ftcal.report.tried_words import BELIEVED, found_words, suspect_words, unseen
from ftcal.report.truth import Truth
from ftcal.report.whole_metrics import (
    directions,
    inertias,
    means,
    move_words,
    nodes,
    on_the_prior,
    touching,
    truth_of,
    undetermined,
)
from ftcal.sensor import AXES
from ftcal.verdict import advice, overall

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.whole_pipeline import WholeOutcome


def whole_html(
    outcome: WholeOutcome, truth: Mapping[str, Float[Array, "6 K"]] | None = None
) -> str:
    """Return the report of a fit of all sensors as one self-contained page.

    `truth` maps sensors to their true gain; the page then shows truth beside estimate. Raises
    `SensorError` where a true gain is not of the shape of its Workbench matrix.
    """
    album = Album()
    robot = robot_section(outcome, album)
    sensors = [
        sensor_section(number, outcome, result, truth or {}, album)
        for number, result in enumerate(outcome.fit.sensors, 1)
    ]
    return rendered(
        "whole.html",
        album,
        name=outcome.robot.name,
        recordings=outcome.recordings,
        together=table_of(outcome.fit.together, ()),
        improved=outcome.improved,
        robot=robot,
        sensors=sensors,
        undetermined=undetermined(outcome),
        health=[health_section(one, outcome.findings, album) for one in outcome.recordings],
        provenance=outcome.calibration.provenance,
    )


def robot_section(outcome: WholeOutcome, album: Album) -> Table:
    """Return what the page says about the robot; its figures go into the album in order."""
    fit = outcome.fit
    told = recordings_of(outcome)
    posterior, choice = fit.posterior, fit.choice
    return {
        "graph": album.add(
            plots.sub_model_graph(outcome.robot.name, nodes(outcome)),
            f"{told}: the parts into which the sensors (on the lines) cut the robot,"
            " with the mass [kg] of the robot description and the equations of its balance that"
            " they gave where nothing touched them. Point at a part for its samples.",
        ),
        "means": means(outcome),
        "residuals": [(one, touching(outcome, one)) for one in fit.residuals],
        "weighings": outcome.weighings,
        "mass": outcome.robot.mass,
        "noise": [(*group, known) for group, known in posterior.noise.items()],
        "inertias": inertias(outcome),
        "tried": [
            {
                "words": suspect_words(one),
                "found": found_words(one),
                "gain": one.gain,
                "held_out": one.held_out,
                "believed": BELIEVED[one.word],
                "moves": f"{one.moves[0].percent:.1f} % {move_words(one.moves[0], fit)}",
            }
            for one in outcome.tried
            if one.seen
        ],
        "unseen": unseen(outcome.tried),
        "believed": outcome.job.whole_body,
        "samples": fit.samples,
        "less": fit.down_weighted,
        "kappa": posterior.kappa,
        "chosen_by": next((s.prior.chosen_by for s in outcome.calibration.sensors), ""),
        "at_the_end": choice is not None and choice.chosen in (choice.kappas[0], choice.kappas[-1]),
        "spent": posterior.spent,
        "entries": posterior.unknowns.prior,
        "curve": None
        if choice is None
        else album.add(
            plots.stretch_curve(choice),
            f"{told}: mean square held out over that of the noise against kappa [fraction of full"
            " scale]. Every stretch was left out in turn; chosen is the strongest prior whose"
            " geometric mean lies within one standard error of the least (with fewer than four"
            " stretches: the weakest within 1 % of it), and none weaker than makes the data most"
            " probable. Far above 1 at its best: a stretch that the others do not foretell.",
        ),
    }


def sensor_section(
    number: int,
    outcome: WholeOutcome,
    result: SensorResult,
    truth: Mapping[str, Float[Array, "6 K"]],
    album: Album,
) -> Table:
    """Return all that the page says about one sensor; its figures go into the album in order."""
    name = result.sensor.name
    record = outcome.calibration.sensor(name)
    compared = truth_of(outcome.fit, result, truth)
    told = recordings_of(outcome)
    return {
        "number": number,
        "name": name,
        "record": record,
        "word": overall(result.verdicts),
        "sentence": advice(result.verdicts),
        "verdicts": result.verdicts,
        "kind": result.scores.kind,
        "table": table_of(result.scores, result.verdicts),
        "residuals": residual_figures(name, result.scores, album),
        "scale": result.scores.by_name["force"].amplitude,
        "share": album.add(
            plots.share_map(
                name, directions(result.share, result.fitted.gain.shape[1]), result.share
            ),
            f"{told}: how much of every entry of the matrix of {name} is the data's"
            " [%], rows against directions of the channels in fractions of full scale; the rest is"
            " the prior's.",
        ),
        "on_the_prior": [
            (direction, "every row" if len(rows) == len(AXES) else f"rows {', '.join(rows)}")
            for direction, rows in on_the_prior(result).items()
        ],
        "loose": loose_scales(outcome.fit.posterior, name),
        "matrices": matrices(result, record),
        "truth": None if compared is None else truth_section(told, name, compared, album),
    }


def recordings_of(outcome: WholeOutcome) -> str:
    """Return the recordings by name, as a caption begins."""
    names = [recording.name for recording in outcome.recordings]
    return f"Recording{'s' * (len(names) > 1)} {', '.join(names)}"


def truth_section(told: str, sensor: str, compared: Truth, album: Album) -> Table:
    """Return the comparison with a known truth."""
    return {
        "figure": album.add(
            plots.truth_maps(f"{sensor}. {told}", compared.truth, compared.estimate, compared.z),
            f"{told}: entries of the true and of the fitted matrix of {sensor} as"
            " departures from the Workbench [% of full scale] (the Workbench is 0 everywhere), and"
            " the error of each in its own standard errors.",
        ),
        "rms": compared.rms,
        "workbench_rms": compared.workbench_rms,
        "within": compared.within,
    }
