"""What fuzzing found worth keeping: every reader answers it with a result or one line.

`tests/corpus/KIND/` holds one small file for every different answer that coverage-guided fuzzing
(atheris, 46 s a reader) came upon; names are digests.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from ftcal import export, logs
from ftcal.config import read_job
from ftcal.errors import FtcalError
from ftcal.urdf import read_robot

CORPUS = Path(__file__).parent / "corpus"
FILES = sorted(file for file in CORPUS.rglob("*") if file.is_file())


def placed(file: Path, folder: Path) -> tuple[Path, Callable[[Path], object]]:
    """Return the file under a name that its reader goes by, and the reader."""
    kind = file.parent.name
    reader: Callable[[Path], object] = logs.read
    name = f"take.{kind}"
    if kind == "yarp":
        name = "right_leg/analog:o/data.log"
    elif kind.startswith("export."):
        name, reader = f"robot{kind.removeprefix('export')}", export.read
    elif kind == "job":
        name, reader = "job.toml", read_job
    elif kind == "urdf":
        reader = read_robot
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(file, path)
    return (folder if kind == "yarp" else path), reader


@pytest.mark.parametrize("file", FILES, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_what_fuzzing_found_is_read_or_told_in_one_line(file: Path, tmp_path: Path) -> None:
    path, reader = placed(file, tmp_path)
    told = "read"
    try:
        reader(path)
    except FtcalError as error:
        told = str(error)
    assert told
    assert "\n" not in told


def test_the_corpus_is_there() -> None:
    assert {"bag", "csv", "db3", "mcap", "parquet", "mat", "npz", "yarp"} <= {
        file.parent.name for file in FILES
    }
