"""The example of every page on a log format runs as it stands there, in ten lines."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from ftcal.config import RecordingSection, read_toml
from ftcal.recording import Recording

PAGES = Path(__file__).resolve().parents[1] / "docs" / "formats"
MINE = ("npz", "robot_logger", "tables", "yarp")


def blocks(page: str, language: str) -> list[str]:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


@pytest.mark.parametrize("page", MINE)
def test_example_of_the_page_reads_a_log(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = blocks(page, "python")
    assert len(example.splitlines()) <= 12
    (tmp_path / "example.py").write_text(example, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    recording = runpy.run_path("example.py")["recording"]
    assert isinstance(recording, Recording)
    assert recording.duration == pytest.approx(4.99, abs=1e-6)  # 500 samples at 100 Hz
    assert len(recording.channels) == 1


@pytest.mark.parametrize("page", MINE)
def test_job_lines_of_the_page_are_known_to_the_job_file(page: str, tmp_path: Path) -> None:
    (lines,) = blocks(page, "toml")
    (tmp_path / "job.toml").write_text(lines, encoding="utf-8")
    (table,) = read_toml(tmp_path / "job.toml")["recordings"]
    assert RecordingSection.model_validate(table).layout() is not None
