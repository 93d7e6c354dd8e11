"""`calibration.json`: its schema, reading back, and what a broken one says."""

from __future__ import annotations

import json
import os
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from ftcal.calibration import read_calibration, schema, to_json, write_whole
from ftcal.config import read_job
from ftcal.errors import OutputError, SensorError
from ftcal.pipeline import Outcome, calibrate, score_calibration
from small_world import truth, write_world

SCHEMA = Path(__file__).resolve().parents[1] / "docs" / "calibration.schema.json"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_world(tmp_path_factory.mktemp("world"))


@pytest.fixture(scope="module")
def outcome(world: Path) -> Outcome:
    return calibrate(read_job(world))


def test_committed_schema_is_the_schema_of_the_code() -> None:
    text = to_json(schema()).decode()
    if os.environ.get("FTCAL_GOLDEN") == "update":
        SCHEMA.write_text(text)
    assert SCHEMA.read_text() == text


def test_every_field_of_the_schema_is_explained() -> None:
    plain = {"recording", "start", "stop", "path", "sha256", "axis", "reason", "kind", "signal"}
    plain |= {"message", "role", "ftcal", "python", "numpy", "inputs", "format", "version"}
    plain |= {"robot", "sensors", "provenance", "prior", "verdicts", "health", "offsets", "verdict"}
    for record in schema()["$defs"].values():
        for name, field in record["properties"].items():
            assert "description" in field or name in plain or name == "chosen_by", name


def test_a_calibration_obeys_its_schema_and_survives_the_file(
    outcome: Outcome, tmp_path: Path
) -> None:
    file = tmp_path / "calibration.json"
    write_whole(file, to_json(outcome.calibration))
    jsonschema.validate(json.loads(file.read_text()), schema())
    assert read_calibration(file) == outcome.calibration


def test_the_arm_finds_its_truth(outcome: Outcome) -> None:
    (sensor,) = outcome.sensors
    assert [v.word for v in sensor.verdicts] == ["ACCEPT"] * 6
    error = np.abs(sensor.fit.estimate.gain - truth()) / sensor.fit.estimate.standard_error
    assert (error < 3).mean() >= 0.94  # two of 36 entries may miss
    assert sensor.hold_out is not None
    assert all(sensor.hold_out.by_name[a].percent < 15 for a in ("force", "torque"))


def test_offsets_belong_to_the_deployed_gain(outcome: Outcome) -> None:
    (record,) = outcome.calibration.sensors
    (sensor,) = outcome.sensors
    for segment, offset in zip((*sensor.training, *sensor.test), record.offsets, strict=True):
        some = segment.samples
        residual = record.model(offset.offset).wrench(some.channels) - some.wrench
        scale = record.prior.full_scale
        np.testing.assert_allclose(residual.mean(axis=0) / scale, 0.0, atol=1e-12)


def test_a_finished_calibration_is_scored_like_its_hold_out(world: Path, outcome: Outcome) -> None:
    job = read_job(world)
    recording = job.recordings[1]
    again = score_calibration(
        outcome.calibration, job.model_copy(update={"recordings": (recording,)})
    )
    first = outcome.sensors[0].hold_out
    assert first is not None
    assert again["ft_sensor"].by_name["force"].rms == pytest.approx(first.by_name["force"].rms)


@pytest.mark.parametrize(
    ("text", "words"),
    [("{}", "robot"), ("not json", "not a calibration"), ('{"format": "other"}', "format")],
)
def test_a_file_that_is_no_calibration_is_named(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "calibration.json"
    file.write_text(text)
    with pytest.raises(SensorError, match=words):
        read_calibration(file)


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "inside").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_whole(tmp_path / "taken", b"content")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
