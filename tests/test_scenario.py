"""The scenario file: what a person may write, what comes of it, and one line for what is wrong."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from ftcal import logs
from ftcal.cli import main
from ftcal.config import Job, read_job
from ftcal.errors import FtcalError, JobError
from ftcal.fit import FitOptions, fit
from ftcal.motion import FixedContact
from ftcal.motions import Pace, grid
from ftcal.paired import pair
from ftcal.pairing import FtChannel, SignalOptions
from ftcal.recording import Recording
from ftcal.robot import Robot
from ftcal.scenario import Scenario, read_scenario
from ftcal.scenes import GridTake
from ftcal.staging import stage
from ftcal.support import standing_on
from ftcal.synthetic import TRUTH, Conditions, SideBySide, Take, read_truth, simulate, write_session
from ftcal.urdf import read_robot
from ftcal.workbench import read_workbench
from pretend import tiled
from small_world import robot_text

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "examples" / "paper" / "session.toml"
SMALL = """
robot = "arm.urdf"
[[sensors]]
name = "ft_sensor"
signal = "hand/analog:o"
[[takes]]
name = "grid"
motion = "grid"
contact = "base"
joints = ["shoulder", "elbow"]
points = [2, 3]
duration = 45
[[takes]]
name = "wide"
motion = "extended balancing"
contact = "base"
joints = ["shoulder", "elbow", "wrist"]
duration = 30
speed = 0.5
held_out = true
temperature = 30
"""
"""On the three-joint arm of `small_world`."""

PORTS = {
    f"{side[0]}_{limb}_ft": f"{side}_{limb}/analog:o"
    for side in ("left", "right")
    for limb in ("arm", "leg", "foot")
}


def scenario(folder: Path, text: str = SMALL) -> Scenario:
    (folder / "arm.urdf").write_text(robot_text(1.0))
    file = folder / "scenario.toml"
    file.write_text(text)
    return read_scenario(file)


def recordings(job: Job) -> list[Recording]:
    return [logs.read(job.path(section.log), section.layout()) for section in job.recordings]


def icub() -> Robot:
    pytest.importorskip("icub_models")
    from ftcal.demonstration import icub_path

    return read_robot(icub_path())


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="ftcal")


def test_a_few_lines_make_a_session_that_reads_back(tmp_path: Path) -> None:
    file, written = stage(scenario(tmp_path), tmp_path / "out")
    job = read_job(file)
    assert [recording.label for recording in job.recordings] == ["grid", "wide"]
    assert job.recordings[1].train == ()
    first, second = recordings(job)
    assert [one.seconds for one in written] == pytest.approx([first.duration, second.duration])
    assert written[0].samples == len(first.channel("hand/analog:o"))
    assert written[0].balance is None
    assert second.temperatures[0].values[0, 0] == 30.0


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_carry_what_yarp_trees_do(tmp_path: Path, form: str) -> None:
    tree, _ = stage(scenario(tmp_path), tmp_path / "yarp")
    table, _ = stage(scenario(tmp_path, f'format = "{form}"\n{SMALL}'), tmp_path / form)
    for theirs, ours in zip(recordings(read_job(tree)), recordings(read_job(table)), strict=True):
        assert ours.start == theirs.start
        for kind in ("joints", "channels", "temperatures"):
            mine = {signal.name: signal for signal in getattr(ours, kind)}
            for signal in getattr(theirs, kind):
                np.testing.assert_array_equal(mine[signal.name].stamps, signal.stamps)
                # a YARP tree keeps six decimals of N, Nm and degrees
                np.testing.assert_allclose(mine[signal.name].values, signal.values, atol=6e-7)


def test_seed_of_the_command_line_wins(tmp_path: Path) -> None:
    made = scenario(tmp_path)
    truths = [
        read_truth(stage(made, tmp_path / str(k), seed=seed)[0].with_name(TRUTH))["ft_sensor"]
        for k, seed in enumerate((None, 1, 2))
    ]
    np.testing.assert_array_equal(truths[0], truths[1])
    assert np.abs(truths[0] - truths[2]).max() > 0.0


def test_a_take_moves_alike_whatever_the_others_do(tmp_path: Path) -> None:
    def wide(text: str) -> np.ndarray:
        made = scenario(tmp_path, text)
        own = np.random.default_rng(1).spawn(2)[1]
        take = made.takes[1].scene(read_robot(tmp_path / "arm.urdf"), own).take
        return take.trajectory.at(np.linspace(0.0, 30.0, 50)).position

    np.testing.assert_array_equal(wide(SMALL), wide(SMALL.replace("[2, 3]", "[3, 3]")))


@pytest.mark.parametrize("degrees", [30.0, 45.0])
def test_range_is_that_of_every_joint_where_its_limits_allow(degrees: float) -> None:
    robot, pace = icub(), Pace()
    joints = ("r_hip_pitch", "r_hip_roll", "r_elbow")
    take = GridTake(
        name="grid", motion="grid", contact="root_link", joints=joints, points=3,
        range_deg=degrees, duration=150.0,
    )  # fmt: skip
    trajectory = take.scene(robot, np.random.default_rng(0)).take.trajectory
    moved = trajectory.at(np.linspace(0.0, 150.0, 15000))
    for name in joints:
        joint, column = robot.joint(name), moved.columns([name])[0]
        home = max(0.0, joint.lower + pace.margin)
        reached = moved.position[:, column].min(), moved.position[:, column].max()
        allowed = (
            max(home - np.deg2rad(degrees), joint.lower + pace.margin),
            min(home + np.deg2rad(degrees), joint.upper - pace.margin),
        )
        # a grid scatters its points by up to a twentieth of the range, inwards
        span = allowed[1] - allowed[0]
        assert allowed[0] - 1e-9 <= reached[0] <= allowed[0] + 0.06 * span
        assert allowed[1] + 1e-9 >= reached[1] >= allowed[1] - 0.06 * span


def test_the_example_of_the_page_runs(tmp_path: Path) -> None:
    icub()
    text = re.search(r"```toml\n(.*?)```", (ROOT / "docs" / "simulate.md").read_text(), re.DOTALL)
    assert text is not None
    (tmp_path / "page.toml").write_text(text[1])
    result = run("simulate", tmp_path / "page.toml", "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    first, second, third, last = result.stdout.splitlines()
    assert first.split()[:1] == ["grid"]
    assert "balance" not in first
    for line in (second, third):
        margin = re.search(r"samples  balance (\d+) mm$", line)
        assert margin is not None
        assert int(margin[1]) >= 0
    assert last == f"wrote {tmp_path / 'out' / 'job.toml'}"
    job = read_job(tmp_path / "out" / "job.toml")
    spans = job.recordings[2].schedule().intervals
    # lowered from the pole, both feet, the left, both, the right, both
    assert [span.touching for span in spans] == [
        ("root_link",), ("root_link", "l_sole", "r_sole"), ("l_sole", "r_sole"), ("l_sole",),
        ("l_sole", "r_sole"), ("r_sole",), ("l_sole", "r_sole"),
    ]  # fmt: skip
    edges = np.array([edge for span in spans for edge in (span.start, span.stop)])
    np.testing.assert_allclose(edges * 100, np.rint(edges * 100), atol=1e-9)
    assert spans[-1].stop >= recordings(job)[2].duration
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["faults"]["switch_share"] == 0.03
    assert truth["links"]["root_link"]["mass"] > 0.0


def test_simulate_for_machines_is_json(tmp_path: Path) -> None:
    scenario(tmp_path)
    result = run("simulate", tmp_path / "scenario.toml", "-o", tmp_path / "out", "--json")
    record = json.loads(result.stdout)
    assert [one["name"] for one in record["recordings"]] == ["grid", "wide"]
    assert Path(record["job"]).is_file()


def test_what_cannot_be_simulated_is_one_line_and_exit_code_1(tmp_path: Path) -> None:
    scenario(tmp_path, SMALL.replace('"shoulder", "elbow"]', '"sholder", "elbow"]'))
    result = run("simulate", tmp_path / "scenario.toml", "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert "did you mean shoulder" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("points =", "poitns ="), ["unknown key 'takes.0.poitns'; did you mean 'points'"]),
        (("held_out =", "heldout ="), ["unknown key 'takes.1.heldout'; did you mean 'held_out'"]),
        (("duration = 45", "sway = 0.1"), ["unknown key 'takes.0.sway'"]),
        (('contact = "base"\njoints', "joints"), ["'takes.0.contact' is missing"]),
        (('"grid"\ncontact', '"gird"\ncontact'), ["takes.0", "'gird'", "'grid'"]),
        (('robot = "arm.urdf"', ""), ["give either robot", "or model"]),
        (("points = [2, 3]", "groups = [['wrist']]"), ["give either joints", "or groups"]),
        (("speed = 0.5", "reach = 0.5\nrange_deg = 10"), ["give reach or range_deg"]),
        (("speed = 0.5", "speed = -1"), ["takes.1.speed = -1"]),
        (("[[sensors]]", "[faults]\nmas = 0.1\n[[sensors]]"), ["'faults.mas'", "'mass'"]),
        (
            ("[[sensors]]", "[faults]\nsaturation = [{sensr = 'a'}]\n[[sensors]]"),
            ["'faults.saturation.0.sensr'; did you mean 'sensor'", "share' is missing"],
        ),
        (("[[sensors]]", "[conditions]\nnois = 1\n[[sensors]]"), ["did you mean 'noise'"]),
        (("[[sensors]]", 'file = "x"\n[[sensors]]'), ["unknown key 'file'"]),
        (('"hand/analog:o"', '"hand"\nfull_scale = [1, 2]'), ["full_scale"]),
    ],
)
def test_what_makes_no_sense_is_told_with_the_near_name(
    tmp_path: Path, change: tuple[str, str], words: list[str]
) -> None:
    assert change[0] in SMALL
    with pytest.raises(JobError) as raised:
        scenario(tmp_path, SMALL.replace(*change, 1))
    message = str(raised.value)
    assert message.startswith(str(tmp_path / "scenario.toml"))
    assert "\n" not in message
    for word in words:
        assert word in message


def test_one_entry_of_points_a_group(tmp_path: Path) -> None:
    text = SMALL.replace('joints = ["shoulder", "elbow"]', 'groups = [["shoulder"], ["elbow"]]', 1)
    with pytest.raises(JobError, match="3 entries of points for 2 groups"):
        scenario(tmp_path, text.replace("[2, 3]", "[2, 3, 4]"))
    trajectory = scenario(tmp_path, text).takes[0].scene(
        read_robot(tmp_path / "arm.urdf"), np.random.default_rng(0)
    ).take.trajectory  # fmt: skip
    moved = trajectory.at(np.linspace(0.0, 45.0, 4500))
    for column, count in ((0, 2), (1, 3)):
        still = moved.velocity[:, column] == 0.0
        places = np.unique(np.round(moved.position[still, column], 9))
        assert len(places) == count + 1  # and home


def test_an_unknown_model_offers_near_names(tmp_path: Path) -> None:
    pytest.importorskip("icub_models")
    made = scenario(tmp_path, SMALL.replace('robot = "arm.urdf"', 'model = "iCubGenova4"'))
    with pytest.raises(FtcalError, match=r"did you mean .*iCubGenova04"):
        stage(made, tmp_path / "out")


def test_the_papers_scenario_has_its_eight_data_sets() -> None:
    made = read_scenario(PAPER)
    assert [take.name for take in made.takes] == [
        "gridMin30", "gridMin45", "balancing", "extBal1", "extBal2", "fastExtBal1", "fastExtBal2",
        "switching",
    ]  # fmt: skip
    assert {sensor.name: sensor.signal for sensor in made.sensors} == PORTS


@pytest.mark.slow
@pytest.mark.no_cover
def test_the_papers_scenario_is_simulated_in_balance(tmp_path: Path) -> None:
    icub()
    _, written = stage(read_scenario(PAPER), tmp_path / "out")
    margins = [one.balance for one in written if one.balance is not None]
    assert len(margins) == 6
    assert min(margins) >= 0.0


def grids(robot: Robot) -> tuple[SideBySide, np.ndarray]:
    """Return brisk walks of both legs and both arms, and the times of their waypoints [s]."""
    parts = {
        ("hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"): 2,
        ("shoulder_roll", "shoulder_yaw", "elbow", "wrist_pitch"): 2,
    }
    groups = [[f"{side}_{name}" for name in names] for side in "lr" for names in parts]
    pace = Pace(speed=1.5, acceleration=8.0)
    walks = [
        grid(robot, group, points=2, duration=61.0, settle=0.05, pace=pace) for group in groups
    ]
    return SideBySide(walks, groups), np.unique(np.concatenate([w.times for w in walks]))


def test_faults_off_every_one_of_six_sensors_is_found_to_the_last_digits(tmp_path: Path) -> None:
    """Least squares on the log as read back and paired, away from the corners of the jerk.

    A minimum-jerk move is a polynomial of order five: filters of order six that lie within one are
    exact, which leaves rounding times the condition of the problem, largest for the feet.
    """
    robot = icub()
    from ftcal.demonstration import icub_path

    walk, corners = grids(robot)
    ideal = Conditions(noise=0.0, digital=False, encoder=0.0, flicker=0.0, jitter=0.0, stagger=0.0)
    session = simulate(
        robot,
        [Take("grid", walk, standing_on(FixedContact("root_link")))],
        sensors=PORTS,
        generator=np.random.default_rng(0),
        conditions=ideal,
    )
    job = read_job(write_session(session, tmp_path / "out", urdf=icub_path(), form="parquet"))
    (recording,), (section,) = recordings(job), job.recordings
    options = SignalOptions(joint_window=0.11, joint_order=6, smoothing=0.05)
    for sensor in job.sensors:
        assert sensor.workbench is not None
        workbench = read_workbench(job.path(sensor.workbench), logged=sensor.logged)
        channel = FtChannel(sensor.name, sensor.signal, workbench)
        paired = pair(
            recording, robot, channel, section.schedule(), gravity=section.gravity, options=options
        ).samples
        within = np.abs(paired.time[:, None] - corners).min(axis=1) > 0.11 / 2 + 0.05 / 2 + 0.02
        kept = dataclasses.replace(
            paired,
            time=paired.time[within],
            channels=paired.channels[within],
            wrench=paired.wrench[within],
        )
        found = fit(tiled(kept), workbench, FitOptions(penalty=0.0))
        true = session.truth[sensor.name].gain
        error = np.linalg.norm(found.estimate.gain - true, axis=1) / np.linalg.norm(true, axis=1)
        assert found.excitation.rank == 6
        assert error.max() < 1e-6, sensor.name
