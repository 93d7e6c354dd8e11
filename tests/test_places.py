"""Where results go: told before the work that they cannot be put there, and nothing left behind."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from ftcal.cli import main
from ftcal.cli.frame import require_writable
from ftcal.errors import OutputError
from small_world import write_world

COMMANDS = {
    "calibrate": ["calibrate", "job.toml", "-o", "PLACE"],
    "the folder of a job": ["calibrate", "placed.toml"],
    "all sensors at once": ["calibrate", "whole.toml", "-o", "PLACE"],
    "calibrate, cache": ["calibrate", "job.toml", "--cache", "PLACE"],
    "study": ["study", "job.toml", "-o", "PLACE"],
    "study, cache": ["study", "job.toml", "--cache", "PLACE"],
    "fleet": ["fleet", "no fleet", "-o", "PLACE"],
    "fleet, cache": ["fleet", "no fleet", "-o", "out", "--cache", "PLACE"],
    "simulate": ["simulate", "no scenario.toml", "-o", "PLACE"],
    "demo": ["demo", "-o", "PLACE"],
    "inspect": ["inspect", "none.csv", "--robot", "arm.urdf", "--feet", "a", "b",
                "--plot", "PLACE/feet.html"],
}  # fmt: skip


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with jobs whose logs are gone: whoever reads them says so."""
    folder = tmp_path / "world"
    folder.mkdir()
    job = write_world(folder).read_text()
    (folder / "placed.toml").write_text('output = "file/below"\n' + job)
    (folder / "whole.toml").write_text(job + '\n[fit]\nscope = "whole body"\n')
    for log in folder.glob("*.csv"):
        if log.name != "workbench.csv":
            log.unlink()
    (folder / "file").write_text("in the way")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("place", ["file", "file/below"])
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_file_in_the_way_is_told_before_anything_is_read(
    world: Path, words: Sequence[str], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: object, **__: object) -> None:
        raise AssertionError("simulated first")

    monkeypatch.setattr("ftcal.demonstration.write_demo", simulated)
    before = sorted(world.rglob("*"))
    result = run(*(word.replace("PLACE", place) for word in words))
    assert result.exit_code == 1, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("ftcal: ")
    assert "file: Not a directory); name another folder with " in line
    assert line.rpartition(" ")[2] in {"-o", *words}
    assert sorted(world.rglob("*")) == before


def test_asking_creates_nothing(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    require_writable(tmp_path / "new" / "newer")
    require_writable(tmp_path / "there")
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a folder that not even root can fill")
def test_a_folder_that_nobody_can_write_is_told_whatever_its_permissions_say() -> None:
    with pytest.raises(OutputError, match=r"^/proc/new: cannot be written \(/proc: .*with -o$"):
        require_writable(Path("/proc/new"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_told(tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        require_writable(tmp_path / "locked" / "new")


def test_a_link_that_leads_nowhere_is_no_folder_to_be_made(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(OutputError, match="No such file or directory"):
        require_writable(tmp_path / "link")


def test_a_name_that_is_too_long_is_told(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="name too long"):
        require_writable(tmp_path / ("n" * 300) / "out")


def test_calibrate_keeps_paired_recordings_and_finds_them_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = write_world(tmp_path)
    monkeypatch.chdir(tmp_path)
    plain = run("calibrate", job, "-o", "plain", "--json")
    assert not list(tmp_path.rglob("*.npz"))
    first = run("calibrate", job, "-o", "first", "--cache", "kept", "--json")
    made = {file: file.stat().st_mtime_ns for file in (tmp_path / "kept").iterdir()}
    assert len(made) == 2
    # read nowhere else: what is on the shelf is named by its hash
    monkeypatch.setattr("ftcal.paired_takes._made", lambda work: pytest.fail("paired again"))
    again = run("calibrate", job, "-o", "again", "--cache", "kept", "--json")
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "kept").iterdir()} == made
    assert plain.stdout == first.stdout == again.stdout
    assert again.exit_code == 0


def test_a_fit_that_keeps_no_recordings_refuses_a_cache(tmp_path: Path) -> None:
    job = write_world(tmp_path)
    job.write_text(job.read_text() + '\n[fit]\nscope = "whole body"\n')
    result = run("calibrate", job, "--cache", tmp_path / "kept")
    assert result.exit_code == 1
    assert "all sensors at once keeps nothing; leave out --cache" in result.stderr
    assert not (tmp_path / "kept").exists()
