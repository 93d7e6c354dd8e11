"""A tree of YARP dumper folders in pieces is the tree that is read at once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ftcal import logs
from ftcal.errors import LogError
from ftcal.logs import dump, yarp_pieces
from ftcal.logs.layout import WRENCH_AXES, Layout
from ftcal.logs.pieces import ROLES, cut
from ftcal.logs.streamed import StreamedPieces
from ftcal.recording import NANOSECONDS
from piecewise import assert_are_pieces, assert_same, put_together
from real import DATA

STEP = 10_000_000  # nanoseconds
START = 1_457_614_036_921_366_000
BLOCK = 300  # bytes: some five lines

one_folder = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def seconds(stamp: int) -> str:
    return f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS // 1000:06d}"


def forces(count: int) -> list[str]:
    """Return values of an F/T port, all different."""
    numbers = np.random.default_rng(count).normal(size=(count, 6))
    return [" ".join(map(repr, row)) for row in numbers.tolist()]


def angles(count: int) -> list[str]:
    """Return values of a motor board of three joints in two groups."""
    numbers = np.random.default_rng(count).normal(size=(count, 3)) * 90
    return [f"({' '.join(map(repr, row))}) [ok] (0 0 0) [ok]" for row in numbers.tolist()]


@dataclass(frozen=True)
class Port:
    """What the folder of a port holds."""

    values: Sequence[str]
    stamps: Sequence[int] | None = None
    """In steps since START; None: one a step."""
    counters: Sequence[int] | None = None
    sessions: Sequence[int] = ()
    """Rows before which the connection was broken, 8 steps, and made again, 2 steps."""
    ending: str = ""
    """What follows the last line."""

    def write(self, root: Path, name: str) -> Path:
        """Write and return the folder."""
        folder = root / "icub" / name
        folder.mkdir(parents=True, exist_ok=True)
        count = len(self.values)
        times = [START + stamp * STEP for stamp in self.stamps or range(count)]
        lines = [
            f"{n % dump.SEQUENCE_SIZE} {seconds(t)} {v}\n"
            for n, t, v in zip(self.counters or range(count), times, self.values, strict=True)
        ]
        (folder / "data.log").write_text("".join(lines) + self.ending)
        made = [START, *(times[row] - 2 * STEP for row in self.sessions)]
        broken = [times[row] - 8 * STEP for row in self.sessions]
        plain = name.partition("_0000")[0]
        events = [f"[{seconds(t)}] /icub/{plain} [connected]\n" for t in made]
        events += [f"[{seconds(t)}] /icub/{plain} [disconnected]\n" for t in broken]
        (folder / "info.log").write_text("Type: Bottle;\nStamp: tx;\n" + "".join(events))
        return folder


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Text is read some five lines at a time."""
    monkeypatch.setattr(dump, "BLOCK", BLOCK)
    monkeypatch.setattr(yarp_pieces, "_TEXT", 2 * BLOCK)


def in_blocks(path: Path, layout: Layout = logs.layout.PLAIN) -> StreamedPieces:
    """Return a log opened in pieces; the test fails where it comes as a whole."""
    opened = logs.in_pieces(path, layout)
    assert isinstance(opened, StreamedPieces)
    return opened


steps = st.lists(st.sampled_from([0, 1, 1, 1, 2, 15]), min_size=1, max_size=40).map(
    lambda steps: [int(stamp) for stamp in np.cumsum(steps)]
)
"""Stamps of which some repeat the one before, and some leave a hole."""

counters = st.lists(st.sampled_from([1, 1, 1, 1, 3, 20_000]), min_size=40, max_size=40).map(
    lambda steps: [int(counter) for counter in np.cumsum(steps) + 32_750]
)
"""Counters of packets, of which some are lost, and some are those of a sender that began again."""


@st.composite
def legs(draw: st.DrawFn) -> Port:
    """Return an F/T port with holes, lost packets, sessions, and a last line that may be cut."""
    stamps = draw(steps)
    packets = draw(counters)[: len(stamps)]
    again = draw(st.sets(st.integers(1, 39), max_size=3))
    ending = draw(st.sampled_from(["", "7 14576", "\n"]))
    sessions = [row for row in sorted(again) if row < len(stamps)]
    return Port(forces(len(stamps)), stamps, packets, sessions, ending)


@pytest.mark.usefixtures("small")
@one_folder
@given(
    leg=legs(), board=steps, late=st.integers(-30, 30), rows=st.integers(1, 50),
    overlap=st.integers(0, 40),
)  # fmt: skip
def test_the_pieces_of_a_tree_are_the_tree(
    leg: Port, board: list[int], late: int, rows: int, overlap: int, tmp_path: Path
) -> None:
    leg.write(tmp_path, "leg/analog:o")
    later = [stamp + late for stamp in board]
    Port(angles(len(board)), later).write(tmp_path, "torso/stateExt:o")
    end = later[-1] + 5
    Port(angles(9), range(end, end + 9)).write(tmp_path, "torso/stateExt:o_00001")
    Port([]).write(tmp_path, "head/inertial")
    whole = logs.read(tmp_path)
    opened = in_blocks(tmp_path)
    margin = overlap * STEP
    pieces = list(opened.pieces(rows=rows, overlap=margin / NANOSECONDS))
    assert_are_pieces(pieces, whole, rows=rows, margin=margin)
    assert opened.head.findings == whole.findings
    for role in ROLES:
        for signal in getattr(whole, role):
            np.testing.assert_equal(opened.period(role, signal.name), signal.period)


@pytest.mark.usefixtures("small")
def test_what_the_whole_reader_notices_is_noticed(tmp_path: Path) -> None:
    """The property above is of little worth where nothing is there to notice."""
    stamps = [*range(20), 19, *range(40, 60)]
    packets = [*range(10), *range(13, 24), *range(30, 50)]
    leg = Port(forces(41), stamps, packets, sessions=[21], ending="50 1457")
    leg.write(tmp_path, "leg/analog:o")
    Port([]).write(tmp_path, "arm/analog:o")
    opened = in_blocks(tmp_path)
    told = {finding.kind: finding.message for finding in opened.head.findings}
    assert told == {
        "empty": "connected for 0.0 s but logged no sample",
        "duplicate stamps": "1 of 41 samples repeat the stamp before them; left out",
        "truncated": "the last line is incomplete; left out",
        # the six packets lost in the hole between the sessions are nobody's loss
        "lost packets": "the packet counter skips 3 of 44 packets",
    }
    assert opened.head.findings == logs.read(tmp_path).findings
    first, second = opened.pieces(rows=20)
    assert (first.own.channels[0].breaks, second.own.channels[0].breaks) == ((), (0,))


@pytest.mark.usefixtures("small")
def test_of_steps_that_cover_a_hole_alike_the_first_opens_the_session(tmp_path: Path) -> None:
    """The sender went on while the dumper was away: every step across the hole is as long."""
    Port(forces(60), sessions=[30]).write(tmp_path, "leg/analog:o")
    pieces = list(in_blocks(tmp_path).pieces(rows=7))
    assert_same(put_together(pieces), logs.read(tmp_path))
    # disconnected at 22, less a tenth of a second for the clocks
    assert put_together(pieces).channels[0].breaks == (13,)


@pytest.mark.usefixtures("small")
def test_nested_measures_are_told_apart_in_pieces(tmp_path: Path) -> None:
    line = "(((1 2 {0}) 7.5)) () () () (((40.5) 7.5)) (((1 2 3 4 5 {0}) 7.5)) () () ()"
    Port([line.format(n) for n in range(30)]).write(tmp_path, "leg/measures:o")
    pieces = list(in_blocks(tmp_path).pieces(rows=7))
    assert_same(put_together(pieces), logs.read(tmp_path))
    assert {role for role in ROLES if getattr(pieces[0].own, role)} == {
        "channels", "temperatures", "imus",
    }  # fmt: skip


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("angle", ["deg", "rad"])
def test_what_a_job_says_of_a_log_holds_in_pieces(tmp_path: Path, angle: str) -> None:
    Port(["1 2 3"] * 20).write(tmp_path, "torso/state:o")
    Port(forces(20)).write(tmp_path, "leg/strain:o")
    Port([str(30 + n) for n in range(20)]).write(tmp_path, "leg/board:o")
    Port(forces(20)).write(tmp_path, "head/xsens:o")
    layout = Layout(
        angle=angle,  # type: ignore[arg-type]
        joints={"torso/state:o": ("yaw", "", "pitch")},
        channels={"leg/strain:o": WRENCH_AXES},
        temperatures={"board": "leg/board:o"},
        imus={"head/xsens:o": ("ax", "ay", "az", "gx", "gy", "gz")},
        acceleration="g",
        zero="leg/strain:o",
    )
    pieces = list(in_blocks(tmp_path, layout).pieces(rows=7))
    assert_same(put_together(pieces), logs.read(tmp_path, layout))


@pytest.mark.usefixtures("small")
def test_one_data_log_is_read_in_pieces(tmp_path: Path) -> None:
    file = Port(forces(20)).write(tmp_path, "leg/analog:o") / "data.log"
    assert_same(put_together(list(in_blocks(file).pieces(rows=7))), logs.read(file))


def refusal(path: Path, layout: Layout = logs.layout.PLAIN) -> tuple[str, str]:
    """Return what is said of a log that is read in pieces, and at once."""
    with pytest.raises(LogError) as at_once:
        logs.read(path, layout)
    with pytest.raises(LogError) as in_pieces:
        logs.in_pieces(path, layout)
    return str(in_pieces.value), str(at_once.value)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("row", [1, 4, 5, 6, 17, 21])
@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("1 2 3 4 5", "line {line}: 7 fields where the first line has 8"),
        ("1 2 3 left 5 6", "line {line}: 'left' is no number"),
        ("1 2 nan 4 5 inf", "row {line}: column 'fz' is nan (2 such values in all)"),
    ],
)
def test_a_line_unlike_the_others_is_refused_by_its_number(
    tmp_path: Path, row: int, value: str, words: str
) -> None:
    values = forces(23)
    values[row] = value
    Port(values).write(tmp_path, "leg/analog:o")
    said, expected = refusal(tmp_path)
    assert said == expected
    assert words.format(line=row + 1) in said


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("row", range(1, 23))
def test_time_that_goes_back_is_refused_across_any_edge(tmp_path: Path, row: int) -> None:
    stamps = list(range(0, 46, 2))
    stamps[row] = 2 * row - 3
    Port(forces(23), stamps=stamps).write(tmp_path, "leg/analog:o")
    said, expected = refusal(tmp_path)
    assert said == expected
    assert f"row {row + 1}: time goes back by 0.010000 s" in said


@pytest.mark.usefixtures("small")
def test_the_first_of_many_faults_is_told_and_all_are_counted(tmp_path: Path) -> None:
    values = forces(23)
    values[3] = values[19] = "nan 1 1 1 1 1"
    stamps = [*range(10), 5, *range(11, 23)]
    Port(values, stamps=stamps).write(tmp_path, "leg/analog:o")
    said, expected = refusal(tmp_path)
    assert said == expected
    assert "row 4: column 'fx' is nan (2 such values in all)" in said


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("row", [0, 7, 22])
@pytest.mark.parametrize("blank", [0, 3])
def test_failed_positions_are_refused_by_their_line(tmp_path: Path, row: int, blank: int) -> None:
    values = angles(23)
    values[row] = values[row].replace("[ok]", "[fail]")
    if row:
        values[row - 1] += "\n" * blank
    Port(values).write(tmp_path, "torso/stateExt:o")
    said, expected = refusal(tmp_path)
    assert said == expected
    assert f"line {row + 1 + (blank if row else 0)}: the motor board marks" in said


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    "fault", ["columns", "overlap", "widths", "empty", "year", "port", "twice"]
)
def test_what_is_no_log_is_refused_alike(tmp_path: Path, fault: str) -> None:
    layout = Layout()
    Port(["1 2 3"] * 9).write(tmp_path, "torso/state:o")
    if fault == "columns":
        layout = Layout(joints={"torso/state:o": ("yaw", "roll", "pitch", "more")})
    elif fault == "overlap":
        Port(["1 2 3"] * 9, stamps=range(8, 17)).write(tmp_path, "torso/state:o_00001")
    elif fault == "widths":
        Port(["1 2"] * 9, stamps=range(9, 18)).write(tmp_path, "torso/state:o_00001")
    elif fault == "empty":
        Port([], ending="7 145").write(tmp_path, "torso/state:o")
    elif fault == "year":
        Port(["1 2 3"] * 9, stamps=[*range(8), 10**12]).write(tmp_path, "torso/state:o")
    elif fault == "port":
        layout = Layout(zero="left_leg")
    else:
        Port(["1 2 3"] * 9).write(tmp_path, "spare/torso/state:o")
        info = (tmp_path / "icub" / "torso" / "state:o" / "info.log").read_bytes()
        (tmp_path / "icub" / "spare" / "torso" / "state:o" / "info.log").write_bytes(info)
    said, expected = refusal(tmp_path, layout)
    assert said == expected


@pytest.mark.usefixtures("small")
@one_folder
@given(
    grouped=st.booleans(),
    scars=st.lists(
        st.tuples(
            st.floats(0, 1), st.integers(0, 3),
            st.sampled_from([b"", b"\n", b"\r\n", b" ", b"(", b"-", b"9", b"nan", b"\0", b"\xff"]),
        ),
        min_size=1, max_size=3,
    ),
)  # fmt: skip
def test_a_damaged_log_is_refused_by_both_or_read_alike(
    grouped: bool, scars: list[tuple[float, int, bytes]], tmp_path: Path
) -> None:
    name = "torso/stateExt:o" if grouped else "leg/analog:o"
    whole = Port(angles(23) if grouped else forces(23)).write(tmp_path, name) / "data.log"
    text = whole.read_bytes()
    for place, lost, added in scars:
        at = round(place * len(text))
        text = text[:at] + added + text[at + lost :]
    whole.write_bytes(text)
    try:
        expected = logs.read(whole)
    except LogError:
        with pytest.raises(LogError):
            logs.in_pieces(whole)
    else:
        assert_same(put_together(list(in_blocks(whole).pieces(rows=7))), expected)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("fate", ["shorter", "gone"])
def test_a_log_that_changes_while_it_is_read_is_named(tmp_path: Path, fate: str) -> None:
    file = Port(forces(200)).write(tmp_path, "leg/analog:o") / "data.log"
    opened = in_blocks(tmp_path)
    if fate == "shorter":
        file.write_bytes(file.read_bytes()[:3000])
    else:
        file.unlink()
    with pytest.raises(LogError, match=r"data\.log: (it was changed|No such file)"):
        list(opened.pieces(rows=10))


@pytest.mark.parametrize(
    "take",
    ["icub-genova01/torso_sweep", "icub-genova02/left_leg_support"],
)
@pytest.mark.parametrize("rows", [None, 777])
def test_the_pieces_of_a_real_log_are_the_log(
    monkeypatch: pytest.MonkeyPatch, take: str, rows: int | None
) -> None:
    folder = DATA / take
    if not folder.is_dir():
        pytest.skip(f"shared/data/{take} is not here")
    monkeypatch.setattr(dump, "BLOCK", 1 << 17)
    opened = in_blocks(folder)
    whole = logs.read(folder)
    pieces = list(opened.pieces(rows=rows, overlap=0.25))
    assert_same(put_together(pieces), whole)
    margin = NANOSECONDS // 4
    for piece in pieces:
        assert_same(piece.recording, cut(whole, piece.start - margin, piece.stop + margin))


def test_memory_does_not_grow_with_the_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy's share and that of the text, not Arrow's."""
    monkeypatch.setattr(dump, "BLOCK", 1 << 16)
    monkeypatch.setattr("ftcal.logs.streamed.NUMBERS", 14_000)
    values = forces(1000) * 60
    Port(values).write(tmp_path, "leg/analog:o")
    tracemalloc.start()
    seen = sum(len(piece.own.channels[0]) for piece in in_blocks(tmp_path).pieces())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seen == 60_000
    # the text is 8.5 MB, its numbers 3.4 MB; a piece is 0.1 MB, and four blocks of 64 kB are read
    assert peak < 2e6
