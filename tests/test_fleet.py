"""A fleet is calibrated wherever it runs, and whatever breaks costs that piece alone."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from ftcal.archive import Shelf
from ftcal.cli import main
from ftcal.compute import Cluster, Here, Processes
from ftcal.config import Job, read_job
from ftcal.drift import Drift, deviations, drift, limit
from ftcal.errors import FtcalError, JobError, LogError, SensorError
from ftcal.fleet import Fleet, RobotState, SensorState, run_fleet
from ftcal.fleet_table import print_fleet
from ftcal.paired_takes import KINDS, paired_take, work_of
from ftcal.pipeline import calibrate, described, score_calibration
from ftcal.remote import fetched
from ftcal.takes import Logs
from ftcal.whole_pipeline import calibrate_whole_body
from pretend import FULL_SCALE
from small_world import JOB, JOINTS, PRIOR, robot_text, take, write_log, write_world

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


def said(calibration: Any) -> dict[str, Any]:
    """Return all that a calibration says but when it was made."""
    record: dict[str, Any] = json.loads(calibration.model_dump_json())
    del record["provenance"]["created"]
    return record


def said_in(file: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(file.read_text())
    del record["provenance"]["created"]
    return record


def warm_job(folder: Path) -> Job:
    """Return a job of two recordings with a thermometer; the offset of the first steps."""
    folder.mkdir(exist_ok=True)
    job = write_world(folder)
    for number, step in ((3, 900.0), (4, 0.0)):
        stamps, joints, channels = take(number)
        channels = channels + step * (stamps > 20.0)[:, None]
        heat = 30.0 + number + 0.05 * stamps
        names = ["time", *JOINTS, *(f"ft/{axis}" for axis in AXES), "ft/temperature"]
        columns = [stamps, *joints.T, *channels.T, heat]
        pq.write_table(
            pa.table(dict(zip(names, columns, strict=True))), folder / f"t{number}.parquet"
        )
    text = JOB.format(full_scale=", ".join(map(str, FULL_SCALE))).split("[[recordings]]")[0]
    text += 'temperature = "heat"\n'
    for number, searched in ((3, 'breaks = "auto"'), (4, "")):
        text += f"""
[[recordings]]
log = "t{number}.parquet"
contact = "base"
{searched}
temperatures = {{ heat = "ft/temperature" }}
"""
    job.write_text(text)
    return read_job(job)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return warm_job(tmp_path_factory.mktemp("warm"))


@pytest.fixture(scope="module")
def serial(warm: Job) -> dict[str, Any]:
    return said(calibrate(warm).calibration)


def test_the_warm_job_shows_what_it_is_for(serial: dict[str, Any]) -> None:
    (sensor,) = serial["sensors"]
    assert sensor["reference_temperature"] == pytest.approx(34.5, abs=0.1)
    assert [offset["recording"] for offset in sensor["offsets"]] == ["t3", "t3", "t4"]


def test_a_temperature_term_asks_for_the_thermometer(warm: Job) -> None:
    calibration = calibrate(warm).calibration
    cold = warm.model_copy(
        update={"sensors": (warm.sensors[0].model_copy(update={"temperature": None}),)}
    )
    assert score_calibration(calibration, warm)
    with pytest.raises(SensorError, match='names no thermometer; add temperature = "heat"'):
        score_calibration(calibration, cold)


def test_a_process_pool_calibrates_as_one_process_does_bit_for_bit(
    warm: Job, serial: dict[str, Any]
) -> None:
    assert said(calibrate(warm, where=Processes(2)).calibration) == serial


def test_a_cluster_calibrates_as_one_process_does_bit_for_bit(
    warm: Job, serial: dict[str, Any], cluster: Cluster
) -> None:
    assert said(calibrate(warm, where=cluster).calibration) == serial


def test_what_lies_on_the_shelf_is_found_and_gives_the_same_bits(
    warm: Job, serial: dict[str, Any], tmp_path: Path
) -> None:
    shelf = Shelf(tmp_path, KINDS)
    first = calibrate(warm, shelf=shelf)
    made = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert len(made) == 2
    again = calibrate(warm, shelf=shelf)
    assert {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()} == made
    assert said(first.calibration) == said(again.calibration) == serial
    assert again.findings == first.findings
    assert [one.source for one in again.recordings] == [one.source for one in first.recordings]
    for file in made:
        file.write_bytes(file.read_bytes()[:-100])
    assert said(calibrate(warm, shelf=shelf).calibration) == serial


def test_with_the_in_situ_offset_another_record_is_kept(warm: Job, tmp_path: Path) -> None:
    robot, channels = described(warm)
    in_situ = warm.model_copy(update={"fit": warm.fit.model_copy(update={"offset": "in situ"})})
    shelf = Shelf(tmp_path, KINDS)
    kept = []
    for job in (warm, in_situ):
        work = work_of(job, robot, channels)["t3"]
        kept += [paired_take(work, shelf), paired_take(work, shelf)]
    attitudes = [one.sensors["ft_sensor"].training[0].attitude for one in kept]
    assert [attitude is None for attitude in attitudes] == [True, True, False, False]


def test_logs_are_read_when_they_are_looked_at(warm: Job) -> None:
    logs = Logs(warm)
    seen = logs.between("t4", 10.0, 12.0)
    signal = seen.channels[0]
    assert seen.name == "t4"
    # 100 Hz, from second zero on
    np.testing.assert_allclose(seen.seconds(signal), np.arange(1000, 1200) / 100, atol=1e-6)
    assert logs.between("t4", 10.0, 12.0) is seen
    with pytest.raises(KeyError):
        logs.between("t5", 0.0, 1.0)


def test_all_broken_recordings_are_told_at_once_wherever_they_were_read(
    tmp_path: Path, cluster: Cluster
) -> None:
    job = warm_job(tmp_path)
    truncate(tmp_path / "t3.parquet")
    (tmp_path / "t4.parquet").unlink()
    with pytest.raises(LogError, match=r"t3\.parquet.*; .*no log at t4\.parquet") as caught:
        calibrate(job, where=cluster)
    assert "\n" not in str(caught.value)


def test_the_scheduler_of_the_job_is_used_and_that_of_the_command_goes_before(
    tmp_path: Path,
) -> None:
    job = write_world(tmp_path)
    job.write_text(job.read_text() + '\n[compute]\nscheduler = "moon"\n')
    refused = run("calibrate", job, "-o", tmp_path / "out")
    assert refused.exit_code == 1
    assert "scheduler 'moon' is none" in refused.stderr
    done = run("calibrate", job, "-o", tmp_path / "out", "--scheduler", "here")
    assert done.exit_code == 0
    by_hand = calibrate(read_job(job)).calibration
    assert said_in(tmp_path / "out" / "calibration.json") == said(by_hand)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:1000])


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def write_robot(folder: Path, seed: int, *, bend: float = 0.0, count: int = 2) -> None:
    """Write a robot with its own recordings; `bend` is what its sensor's third channel changed."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(robot_text())
    np.savetxt(folder / "workbench.csv", PRIOR.gain, delimiter=",")
    mixed = np.eye(6)
    mixed[:, 2] += bend
    for number in range(count):
        stamps, joints, channels = take(seed + number, seconds=20.0)
        write_log(folder / f"t{number}.csv", stamps, joints, channels @ mixed.T)
    head = JOB.format(full_scale=", ".join(map(str, FULL_SCALE))).split("[[recordings]]")[0]
    sections = (f'[[recordings]]\nlog = "t{k}.csv"\ncontact = "base"\n' for k in range(count))
    (folder / "job.toml").write_text(head + "\n".join(sections))


@pytest.fixture(scope="module")
def three_robots(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Fleet]:
    folder = tmp_path_factory.mktemp("three")
    for number, name in enumerate(("ada", "bob", "lab/eve")):
        write_robot(folder / "herd" / name, 100 + 10 * number)
    return folder, run_fleet(str(folder / "herd"), folder / "out", where=Here())


@pytest.fixture
def first(three_robots: tuple[Path, Fleet]) -> Fleet:
    """Return what the first run on the three robots gave."""
    return three_robots[1]


@pytest.fixture
def herd(three_robots: tuple[Path, Fleet], tmp_path: Path) -> Path:
    """Return a folder of three robots that a test may change; `out` beside it has their results."""
    for name in ("herd", "out"):
        shutil.copytree(three_robots[0] / name, tmp_path / name)
    return tmp_path / "herd"


def stamps_of(folder: Path) -> dict[Path, int]:
    return {file: file.stat().st_mtime_ns for file in sorted(folder.rglob("*")) if file.is_file()}


def printed(fleet: Fleet) -> list[str]:
    console = Console(width=100, record=True, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115
    print_fleet(console, fleet)
    console.file.close()
    return console.export_text().splitlines()


def test_a_fleet_gives_what_each_job_gives_alone(first: Fleet, herd: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert first.whole
    assert (first.paired, first.fitted) == (6, 3)
    assert [robot.name for robot in first.robots] == ["ada", "bob", "lab/eve"]
    for name in ("ada", "bob", "lab/eve"):
        alone = calibrate(read_job(herd / name / "job.toml")).calibration
        assert said_in(out / name / "calibration.json") == said(alone)
        assert json.loads((out / name / "metrics.json").read_text())["sensors"]
        assert not (out / name / "report.html").exists()


def test_what_is_finished_is_not_done_again(herd: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    before = stamps_of(out)
    again = run_fleet(str(herd), out, where=Here())
    assert (again.paired, again.fitted) == (0, 0)
    assert stamps_of(out) == before
    assert {s.changed for robot in again.robots for s in robot.sensors} == {"new"}
    job = herd / "ada" / "job.toml"
    job.write_text(job.read_text() + "\n[fit]\nkappa = 0.03\n")
    changed = run_fleet(str(herd), out, where=Here())
    assert (changed.paired, changed.fitted) == (0, 1)  # the fit alone has changed
    reported = run_fleet(str(herd), out, where=Here(), report=True)
    assert (reported.paired, reported.fitted) == (0, 3)
    assert (out / "lab" / "eve" / "report.html").exists()


def test_a_broken_recording_costs_itself_alone_and_is_named(herd: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_robot(herd / "bob", 300, count=3)
    (herd / "bob" / "t1.csv").write_bytes(b"PAR1 not a table at all")
    (herd / "cat").mkdir()
    (herd / "cat" / "job.toml").write_text('robot = "none.urdf"\n')
    result = run("fleet", herd, "-o", out, "--scheduler", "here")
    assert result.exit_code == 1
    told = " ".join(result.stdout.split())
    assert "not calibrated: cat: " in told
    assert "'sensors' is missing" in told
    assert "left out: bob, t1: " in told
    assert " 2/3 " in told
    kept = said_in(out / "bob" / "calibration.json")["provenance"]["inputs"]
    assert [one["path"] for one in kept if one["role"] == "recording"] == ["t0.csv", "t2.csv"]
    assert (out / "ada" / "calibration.json").exists()
    write_robot(herd / "bob", 300, count=3)  # mended: its pieces that were whole are kept
    (herd / "cat" / "job.toml").unlink()
    mended = json.loads(run("fleet", herd, "-o", out, "--json", "--scheduler", "here").stdout)
    assert (mended["paired"], mended["fitted"]) == (1, 1)
    assert mended["robots"]["bob"]["used"] == ["t0", "t1", "t2"]


def test_a_robot_without_a_whole_recording_keeps_what_it_had(herd: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    before = stamps_of(out / "ada")
    for log in (herd / "ada").glob("t*.csv"):
        log.unlink()
    fleet = run_fleet(str(herd), out, where=Here())
    assert not fleet.whole
    (ada, *_) = fleet.robots
    assert "none of its recordings could be read" in ada.reason
    assert stamps_of(out / "ada") == before


def workers_of(pid: int) -> list[int]:
    """Return the processes that a running pool has started to work."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    called = {int(one): Path(f"/proc/{one}/cmdline").read_bytes() for one in children}
    return [one for one, command in called.items() if b"spawn_main" in command]


def wait_until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks at processes by /proc")
def test_killed_without_warning_runs_and_workers_cost_what_was_under_way(tmp_path: Path) -> None:
    for number in range(2):
        write_robot(tmp_path / "herd" / f"r{number}", 100 * number, count=5)
    out, cache = tmp_path / "out", tmp_path / "out" / "cache"
    command = [sys.executable, "-m", "ftcal.cli", "fleet", str(tmp_path / "herd"), "-o", str(out),
               "--workers", "2", "--json"]  # fmt: skip

    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
        wait_until(lambda: len(list(cache.glob("*.npz"))) >= 2)
        workers = workers_of(first.pid)
        first.kill()
    assert len(workers) == 2
    wait_until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))
    kept = {file: file.stat().st_mtime_ns for file in cache.glob("*.npz")}

    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as second:
        wait_until(lambda: len(list(cache.glob("*.npz"))) > len(kept))
        wait_until(lambda: workers_of(second.pid) != [])
        os.kill(workers_of(second.pid)[0], signal.SIGKILL)
        printed_json = second.communicate()[0]
    assert second.returncode == 0
    told = json.loads(printed_json)
    assert all(len(robot["used"]) == 5 for robot in told["robots"].values())
    assert told["fitted"] == 2
    assert told["paired"] <= 10 - len(kept)
    assert kept.items() <= stamps_of(cache).items()
    assert len(list(cache.glob("*.npz"))) == 10


def test_a_cluster_gives_the_fleet_of_one_process(
    first: Fleet, herd: Path, tmp_path: Path, cluster: Cluster
) -> None:
    assert run_fleet(str(herd), tmp_path / "far", where=cluster) == first
    for name in ("ada", "bob", "lab/eve"):
        one, two = (tmp_path / way / name / "calibration.json" for way in ("out", "far"))
        assert said_in(one) == said_in(two)


def test_a_robot_whose_sensors_are_fitted_at_once_takes_part(tmp_path: Path) -> None:
    write_robot(tmp_path / "herd" / "ada", 100)
    job = tmp_path / "herd" / "ada" / "job.toml"
    job.write_text(job.read_text() + '\n[fit]\nscope = "whole body"\n')
    out = tmp_path / "out"
    assert run_fleet(str(job.parent.parent), out, where=Processes(2)).fitted == 1
    alone = calibrate_whole_body(read_job(job)).calibration
    assert said_in(out / "ada" / "calibration.json") == said(alone)
    assert run_fleet(str(job.parent.parent), out, where=Here()).fitted == 0
    write_robot(tmp_path / "new", 200)
    shutil.copy(tmp_path / "new" / "t1.csv", job.parent)
    assert run_fleet(str(job.parent.parent), out, where=Here()).fitted == 1


def test_a_sensor_that_was_bent_is_first_and_one_newly_measured_is_steady(
    herd: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    write_robot(herd / "ada", 500)
    write_robot(herd / "bob", 510, bend=0.02)
    result = run("fleet", herd, "-o", out, "--json", "--scheduler", "here")
    assert result.exit_code == 0
    rows = json.loads(result.stdout)["sensors"]
    assert [(row["robot"], row["changed"]) for row in rows] == [
        ("bob", "drifted"), ("ada", "steady"), ("lab/eve", "new"),
    ]  # fmt: skip
    assert rows[0]["drift"]["sd"] > limit(6) > rows[1]["drift"]["sd"] > 0.0
    # asked again, the answer is the same: compared is with what the latest replaced
    (out / "bob" / "fleet.json").unlink()
    again = json.loads(run("fleet", herd, "-o", out, "--json", "--scheduler", "here").stdout)
    assert again["sensors"] == rows
    assert again["fitted"] == 1
    other = run_fleet(str(herd), tmp_path / "other", where=Here(), since=out)
    assert {s.drift.sd for robot in other.robots for s in robot.sensors if s.drift} == {0.0}


def test_the_table_fits_a_terminal_and_names_what_could_not_be_done(
    herd: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    write_robot(herd / "bob", 510, bend=0.02)
    (herd / "ada" / "t1.csv").write_text("[bold]no log[/]")
    lines = printed(run_fleet(str(herd), out, where=Here()))
    table = [line for line in lines if "ft_sensor" in line]
    assert [line.split()[0] for line in table] == ["bob", "ada", "lab/eve"]
    assert max(map(len, table)) <= 100
    assert [line for line in lines if line.startswith("left out: ada, t1: ")]
    done = "new in this run: 2 robots fitted, 2 recordings paired"
    assert lines[-1] == f"3 robots, 5 recordings; {done}"


def test_long_names_are_folded_and_never_cut() -> None:
    found = Drift(1345.6, 12.34, 0.456, 134.23, drifted=True)
    states = (SensorState("r_upper_leg_ft_sensor", "PARTIAL", "drifted", found),)
    robot = RobotState("laboratory/icub_genova_02", "", ("take",) * 200, {}, states)
    lines = printed(Fleet((robot,), {}, 3, 1))
    assert max(map(len, lines)) <= 100
    cells = [line.split() for line in lines[3:-2]]
    assert "".join(words[0] for words in cells if words) == robot.name
    assert {"1346", "134.2", "200/200"} <= {word for words in cells for word in words}


def test_an_exchanged_sensor_is_no_drift(herd: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    matrix = herd / "ada" / "workbench.csv"
    np.savetxt(matrix, 1.01 * np.loadtxt(matrix, delimiter=","), delimiter=",")
    ada, *_ = run_fleet(str(herd), out, where=Here()).robots
    assert ada.sensors[0].changed == "exchanged"
    assert ada.sensors[0].drift is None


def test_deviations_are_one_where_the_errors_alone_differ(herd: Path) -> None:
    rng = np.random.default_rng(5)
    (sensor,) = calibrate(read_job(herd / "ada" / "job.toml")).calibration.sensors
    covariance = np.array(sensor.covariance)[:, :6, :6]
    found = []
    for _ in range(400):
        noise = [
            np.array([rng.multivariate_normal(np.zeros(6), one, method="cholesky")
                      for one in covariance]) for _ in range(2)
        ]  # fmt: skip
        one, two = (
            sensor.model_copy(update={"fitted_gain": (np.array(sensor.fitted_gain) + n).tolist()})
            for n in noise
        )
        found.append(deviations(one, two) ** 2)
    # 2400 rows of six: the mean of chi-square over its degrees errs by 1.2 %
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)
    assert np.mean(np.array(found) > limit(6) ** 2) < 0.002
    assert drift(sensor, sensor) is not None


def test_a_place_without_a_robot_is_told(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"no job\.toml below it"):
        run_fleet(str(tmp_path), tmp_path / "out", where=Here())


def test_results_below_the_fleet_are_not_robots(herd: Path) -> None:
    write_robot(herd / "out" / "cache" / "old", 1)
    fleet = run_fleet(str(herd), herd / "out", where=Here())
    assert [robot.name for robot in fleet.robots] == ["ada", "bob", "lab/eve"]


def put(herd: Path, url: str) -> Any:
    """Copy a fleet to a URL; return the file system."""
    fsspec = pytest.importorskip("fsspec")
    far, root = fsspec.core.url_to_fs(url)
    for file in herd.rglob("*"):
        if file.is_file():
            target = f"{root}/{file.relative_to(herd).as_posix()}"
            far.makedirs(target.rsplit("/", 1)[0], exist_ok=True)
            far.pipe_file(target, file.read_bytes())
    return far


@pytest.mark.parametrize("kind", ["file", "memory"])
def test_a_fleet_behind_a_url_is_fetched_once_and_gives_the_same(
    first: Fleet, herd: Path, tmp_path: Path, kind: str
) -> None:
    url = {"file": f"file://{tmp_path}/far", "memory": f"memory://{tmp_path.name}/far"}[kind]
    far = put(herd, url)
    out = tmp_path / "fetched"
    assert run_fleet(url, out, where=Here()) == first
    for name in ("ada", "lab/eve"):
        one, two = (tmp_path / way / name / "calibration.json" for way in ("out", "fetched"))
        assert said_in(one) == said_in(two)
    before = stamps_of(out)
    again = run_fleet(url, out, where=Here())
    assert (again.paired, again.fitted) == (0, 0)
    assert stamps_of(out) == before
    other = (herd / "bob" / "t0.csv").read_bytes()
    far.pipe_file(f"{far._strip_protocol(url)}/ada/t1.csv", other)
    changed = run_fleet(url, out, where=Here())
    assert (changed.paired, changed.fitted) == (1, 1)


def test_names_that_lead_out_of_the_folder_are_not_fetched(herd: Path, tmp_path: Path) -> None:
    url = f"memory://{tmp_path.name}/evil"
    far = put(herd, url)
    inside = f"/{tmp_path.name}/evil/ada/t1.csv"
    far.store[f"/{tmp_path.name}/evil/../../../escaped"] = far.store[inside]
    base, faults = fetched(url, tmp_path / "cache")
    assert list(faults.values()) == ["its name leads out of the folder"]
    assert not list(tmp_path.rglob("escaped"))
    assert (base / "ada" / "t1.csv").is_file()


def test_a_url_without_fsspec_or_of_no_known_kind_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run("fleet", "nowhere://at/all", "-o", tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("ftcal: nowhere://at/all: cannot be opened (")
    assert result.stderr.count("\n") == 1
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(FtcalError, match=r'pip install "ftcal\[remote\]"'):
        run_fleet("memory://x", tmp_path, where=Here())


@pytest.mark.parametrize(
    ("protocol", "module", "package"), [("s3", "s3fs", "s3fs"), ("smb", "smbclient", "smbprotocol")]
)
def test_a_url_whose_file_system_is_not_installed_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: str, module: str, package: str
) -> None:
    registry = pytest.importorskip("fsspec.registry")
    monkeypatch.setattr(registry, "_registry", {})
    monkeypatch.setitem(sys.modules, module, None)
    result = run("fleet", f"{protocol}://bucket/herd", "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert result.stderr == (
        f"ftcal: {protocol}://bucket/herd: {protocol}:// needs {package}:"
        f' pip install "ftcal[remote]" {package}\n'
    )
    assert not (tmp_path / "out").exists()
