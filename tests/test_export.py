"""Every exported file, read with the reader's own formula, says what the calibration says."""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ftcal import export as exports
from ftcal import firmware
from ftcal.calibration import SensorCalibration, to_json
from ftcal.cli import main
from ftcal.errors import OutputError, SensorError
from ftcal.export import FORMATS, Installed, pieces
from ftcal.export.installed import Sheet, installed, sheet
from ftcal.export.wording import number
from golden import check
from pretend_calibration import (
    calibration,
    exact,
    exact_prior,
    exact_secondary,
    random_gains,
    sensor,
)
from real import ROOT

SIX = tuple(FORMATS)
EIGHT = ("ati", "c", "json", "npz")
ORIGIN = {
    "ftcal": "0.0.0",
    "calibration": "calibration.json",
    "sha256": "0123abcd",
    "created": "2026-01-02T03:04:05+00:00",
    "calibrated_with": "0.0.0",
}
WARM: dict[str, Any] = {"temperature_gain": (0.5, -0.25, 2.0, 0.0, 0.125, -0.5)}
R = np.random.default_rng(5).uniform(-32767, 32767, (40, 6))


def sheet_of(*sensors: SensorCalibration, offset: str = "auto", undo: bool = False) -> Sheet:
    return sheet(calibration(*sensors), ORIGIN, offset=offset, undo=undo)


def written(known: SensorCalibration, folder: Path) -> Path:
    path = folder / "calibration.json"
    path.write_bytes(to_json(calibration(known)))
    return path


def run(*command: str | Path) -> Any:
    return CliRunner().invoke(main, [str(word) for word in command])


def readings(law: Installed, channels: np.ndarray) -> np.ndarray:
    """Return what the law is applied to."""
    if law.reads == "channels":
        return channels
    assert law.workbench is not None
    return np.asarray(channels @ law.workbench.gain.T)


def wrench(law: Installed, channels: np.ndarray, temperature: float = 0.0) -> np.ndarray:
    w = readings(law, channels) @ law.matrix.T + law.offset
    if law.temperature_gain is not None:
        w = w + law.temperature_gain * (temperature - law.reference_temperature)
    return np.asarray(w)


finite = st.floats(-1e4, 1e4)


@pytest.mark.parametrize("kind", SIX)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    channels=st.sampled_from([6, 8]),
    offset=st.lists(finite, min_size=6, max_size=6),
    warm=st.none() | st.lists(finite, min_size=6, max_size=6),
    reference=st.floats(-40, 90),
)
def test_export_and_read_gives_the_same_law(
    tmp_path: Path,
    kind: str,
    seed: int,
    channels: int,
    offset: list[float],
    warm: list[float] | None,
    reference: float,
) -> None:
    if channels == 8 and kind not in EIGHT:
        return
    gain, prior = random_gains(seed, channels)
    known = sensor(
        gain, prior, offset=offset, temperature_gain=warm, reference_temperature=reference,
        logged="channels" if channels == 8 else "wrench",
    )  # fmt: skip
    made = pieces(kind, sheet_of(known))
    for name, content in made.items():
        (tmp_path / name).write_bytes(content)
    (back,) = exports.read(tmp_path / [name for name in made if not name.endswith(".txt.json")][-1])
    again = back.on("channels")
    # S and back costs the condition of the Workbench, about ten; words are rounded to half a step
    step = FORMATS[kind].rounding(installed(known, "auto")) if kind == "firmware" else 0.0
    assert (np.abs(again.matrix - gain) <= step + 1e-13 * np.abs(gain).max()).all()
    assert again.sensor == known.sensor
    if kind not in ("firmware", "ati"):
        np.testing.assert_array_equal(again.offset, offset)
        np.testing.assert_array_equal(
            np.zeros(6) if again.temperature_gain is None else again.temperature_gain,
            np.zeros(6) if warm is None else warm,
        )
        assert warm is None or again.reference_temperature == reference


@pytest.mark.parametrize("kind", EIGHT)
def test_eight_channels_come_back_as_eight(kind: str) -> None:
    gain, prior = random_gains(3, 8)
    made = pieces(kind, sheet_of(sensor(gain, prior, logged="channels")))
    ((name, content),) = made.items()
    (back,) = FORMATS[kind].decode(content, name)
    np.testing.assert_array_equal(back.matrix, gain)


@pytest.mark.parametrize("kind", ["yarp", "firmware", "ros"])
def test_a_format_of_six_channels_refuses_eight(kind: str) -> None:
    gain, prior = random_gains(3, 8)
    with pytest.raises(SensorError, match="8 channels"):
        pieces(kind, sheet_of(sensor(gain, prior, logged="channels")))


def test_numbers_are_floats_to_every_reader() -> None:
    assert [number(value) for value in (1e-5, 1e22, 2.0, -0.1)] == [
        "1.0e-05",
        "1.0e+22",
        "2.0",
        "-0.1",
    ]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_reads_back_to_the_same_bits(value: float) -> None:
    text = number(value)
    assert float(text) == value
    assert "." in text


def test_the_formula_of_the_yarp_device_gives_our_wrench() -> None:
    """The device computes S m - FT_OFFSET + tc (T - T0) from the board's wrench m."""
    gain, prior = random_gains(1, 6)
    known = sensor(gain, prior, **WARM)
    root = ElementTree.fromstring(pieces("yarp", sheet_of(known))["ft_calibration.xml"])
    held = {
        str(group.get("name")): np.array(
            [float(x) for x in str(group[0].text).strip(" \n()").split(",")]
        )
        for group in root.findall("group")
    }
    assert [param.get("name") for param in root.iter("param")] == ["r_leg_ft_sensor"] * 3
    S = held["FT_SECONDARY_CALIBRATION"].reshape(6, 6)
    tc = held["FT_TEMPERATURE_COEFFICIENTS"]
    device = R @ prior.T @ S.T - held["FT_OFFSET"] + tc[:6] * (41.5 - tc[6])
    ours = known.model().wrench(R, np.full(len(R), 41.5))
    # sums of terms of thousands of newtons
    np.testing.assert_allclose(device, ours, rtol=0, atol=1e-8)


def test_yarp_has_no_group_for_what_is_not_there() -> None:
    text = pieces("yarp", sheet_of(exact(), offset="zero"))["ft_calibration.xml"].decode()
    assert 'FT_OFFSET"' not in text
    assert "FT_TEMPERATURE" not in text


def parameters(known: SensorCalibration) -> dict[str, Any]:
    """Return the ROS parameters as a YAML library reads them."""
    yaml = pytest.importorskip("ruamel.yaml")
    content = pieces("ros", sheet_of(known))["ft_broadcasters.yaml"]
    return dict(yaml.YAML(typ="safe", pure=True).load(content.decode()))


def broadcast(node: dict[str, Any], x: np.ndarray) -> np.ndarray:
    """Return what the broadcaster publishes: the offset is added first, then the multiplier."""

    def six(name: str) -> np.ndarray:
        return np.array([node[name][part][axis] for part in ("force", "torque") for axis in "xyz"])

    return np.asarray((x + six("offset")) * six("multiplier"))


def test_a_broadcaster_publishes_our_wrench_where_nothing_talks_across() -> None:
    _, prior = random_gains(1, 6)
    known = sensor(np.diag([1.1, 0.9, 1.0, 1.2, 0.8, 1.05]) @ prior, prior)
    node = parameters(known)["r_leg_ft_sensor_broadcaster"]["ros__parameters"]
    ours = known.model().wrench(R)
    np.testing.assert_allclose(broadcast(node, R @ prior.T), ours, rtol=0, atol=1e-8)
    assert node["sensor_name"] == "r_leg_ft_sensor"
    assert node["frame_id"] == "r_hip_3"


def test_a_broadcaster_is_off_by_what_is_printed_and_right_in_the_middle() -> None:
    gain, prior = random_gains(2, 6)
    known = sensor(gain, prior)
    node = parameters(known)["r_leg_ft_sensor_broadcaster"]["ros__parameters"]
    low, high = np.array([known.envelope[axis] for axis in ("fx", "fy", "fz", "tx", "ty", "tz")]).T
    corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(6, -1).T
    loads = np.vstack([(low + high) / 2, corners])
    law = installed(known, "auto").on("wrench")
    x = np.linalg.solve(law.matrix, (loads - law.offset).T).T
    error = broadcast(node, x) - loads
    np.testing.assert_allclose(error[0], 0, atol=1e-9)
    said = ", ".join(
        f"{axis} {worst:.2g} ("
        for axis, worst in zip(("fx",), np.abs(error).max(axis=0)[:1], strict=True)
    )
    (line,) = (
        text for text in FORMATS["ros"].remarks(installed(known, "auto")) if "multipliers" in text
    )
    assert said in line


def test_the_law_block_is_the_whole_law() -> None:
    gain, prior = random_gains(2, 6)
    known = sensor(gain, prior, **WARM)
    chain = parameters(known)["r_leg_ft_sensor_law"]["ros__parameters"]["sensor_filter_chain"]
    assert chain["filter1"]["type"] == "wrench_law/WrenchLawFilter"
    node = chain["filter1"]["params"]
    w = R @ prior.T @ np.reshape(node["matrix"], (6, 6)).T + node["offset"]
    w = w + np.array(node["temperature_gain"]) * (25.0 - node["reference_temperature"])
    np.testing.assert_allclose(w, known.model().wrench(R, np.full(len(R), 25.0)), atol=1e-8)


ROS_HEADERS = {
    "filters/filter_base.hpp": """#pragma once
#include <map>
#include <string>
#include <vector>
namespace filters {
template<typename T> class FilterBase {
public:
  virtual ~FilterBase() {}
  bool start(std::map<std::string, std::vector<double>> p) { params_ = p; return configure(); }
  virtual bool update(const T & in, T & out) = 0;
protected:
  virtual bool configure() = 0;
  bool getParam(const std::string & name, std::vector<double> & value) {
    if (!params_.count(name)) return false;
    value = params_[name]; return true; }
private:
  std::map<std::string, std::vector<double>> params_;
}; }""",
    "geometry_msgs/msg/wrench_stamped.hpp": """#pragma once
#include <string>
namespace geometry_msgs { namespace msg {
struct Vector3 { double x, y, z; };
struct Wrench { Vector3 force, torque; };
struct WrenchStamped { std::string header; Wrench wrench; }; } }""",
    "pluginlib/class_list_macros.hpp": "#define PLUGINLIB_EXPORT_CLASS(a, b)",
}
"""What the plugin of the page uses of ROS, by the names and signatures that it has there."""


def test_the_filter_of_the_page_publishes_our_wrench(tmp_path: Path) -> None:
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler here")
    gain, prior = random_gains(2, 6)
    known = sensor(gain, prior)
    node = parameters(known)["r_leg_ft_sensor_law"]["ros__parameters"]
    params = node["sensor_filter_chain"]["filter1"]["params"]
    for name, text in ROS_HEADERS.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```cpp\n(.*?)```", page, re.DOTALL)
    values = {name: ", ".join(map(repr, params[name])) for name in ("matrix", "offset")}
    x = R[:1] @ prior.T
    words = ", ".join(map(repr, map(float, x[0])))
    (tmp_path / "main.cpp").write_text(
        f"""#include <cstdio>
{source}
int main() {{
  wrench_law::WrenchLawFilter filter;
  if (filter.start({{{{"matrix", {{1.0}}}}, {{"offset", {{1.0}}}}}})) return 1;
  if (!filter.start({{{{"matrix", {{{values["matrix"]}}}}}, {{"offset", {{{values["offset"]}}}}}}}))
    return 2;
  double v[6] = {{{words}}};
  wrench_law::Wrench in{{"stamp", {{{{v[0], v[1], v[2]}}, {{v[3], v[4], v[5]}}}}}}, out;
  if (!filter.update(in, out) || out.header != "stamp") return 3;
  auto w = out.wrench;
  printf("%.17g %.17g %.17g %.17g %.17g %.17g", w.force.x, w.force.y, w.force.z,
         w.torque.x, w.torque.y, w.torque.z);
}}
"""
    )
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-I."]
    subprocess.run([compiler, *flags, "main.cpp", "-o", "main"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    w = np.array(done.stdout.split(), float)
    np.testing.assert_allclose(w, known.model().wrench(R[:1])[0], rtol=0, atol=1e-8)


def test_our_reader_and_a_yaml_library_read_the_same() -> None:
    from ftcal.export.ros import parsed

    yaml = pytest.importorskip("ruamel.yaml")
    text = pieces("ros", sheet_of(exact(**WARM)))["ft_broadcasters.yaml"].decode()
    assert parsed(text, "here") == yaml.YAML(typ="safe", pure=True).load(text)


@pytest.mark.parametrize("channels", [6, 8])
def test_both_kinds_of_rows_of_an_ati_file_and_its_bias_give_our_wrench(channels: int) -> None:
    """ATI computes M (v - bias): M is UserAxis, or Axis / scale where the transform is none."""
    gain, prior = random_gains(4, channels)
    known = sensor(gain, prior, logged="channels")
    content = pieces("ati", sheet_of(known))["FT_r_leg_ft_sensor.cal"]
    part = ElementTree.fromstring(content)[0]
    rows = [np.array(axis.get("values", "").split(), float) for axis in part.iter("UserAxis")]
    basic = [
        np.array(axis.get("values", "").split(), float) / float(axis.get("scale", ""))
        for axis in part.iter("Axis")
    ]
    np.testing.assert_array_equal(rows, basic)
    moved = part.find("BasicTransform")
    assert moved is not None
    assert set(moved.attrib.values()) == {"0"}
    said = next(line for line in content.decode().splitlines() if "bias:" in line)
    bias = np.array(said.partition("bias:")[2].split(), float)
    v = np.random.default_rng(0).uniform(-32767, 32767, (9, channels))
    # the bias has seven digits, as float32 in ATI's library
    np.testing.assert_allclose(
        (v - bias) @ np.array(rows).T, v @ gain.T + known.offsets[-1].offset, atol=1e-4
    )


def test_a_cal_file_in_newton_millimetres_is_read_in_newton_metres(tmp_path: Path) -> None:
    axes = "".join(f'<UserAxis Name="{name}" values="1 2 3 4 5 6" max="9"/>'
                   for name in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"))  # fmt: skip
    (tmp_path / "FT1.cal").write_text(
        '<FTSensor Serial="FT1" NumGages="6"><Calibration ForceUnits="N" TorqueUnits="N-mm">'
        f"{axes}</Calibration></FTSensor>"
    )
    (law,) = exports.read(tmp_path / "FT1.cal")
    assert law.sensor == "FT1"
    np.testing.assert_allclose(law.matrix[2], [1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(law.matrix[3], np.array([1, 2, 3, 4, 5, 6]) * 1e-3)


@pytest.mark.parametrize(
    ("channels", "warm"), [(6, None), (6, (0.5, -0.25, 2.0, 0.0, 0.125, -0.5)), (8, None)]
)
def test_the_c_function_compiles_without_warning_and_gives_our_wrench(
    tmp_path: Path, channels: int, warm: tuple[float, ...] | None
) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here")
    gain, prior = random_gains(6, channels)
    logged = "wrench" if channels == 6 else "channels"
    known = sensor(gain, prior, logged=logged, temperature_gain=warm)  # type: ignore[arg-type]
    content = pieces("c", sheet_of(known))["ft_calibration.h"]
    (tmp_path / "ft_calibration.h").write_bytes(content)
    r = np.random.default_rng(0).uniform(-32767, 32767, (5, channels))
    x = r @ prior.T if logged == "wrench" else r
    argument = ", 41.5" if warm else ""
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "ft_calibration.h"\n#include "ft_calibration.h"\n'
        f"int main(void) {{ double x[{channels}], w[6];\n"
        f"  while (1) {{ for (int i = 0; i < {channels}; ++i)"
        ' if (scanf("%lf", &x[i]) != 1) return 0;\n'
        f"    r_leg_ft_sensor_wrench(x{argument}, w);\n"
        '    for (int i = 0; i < 6; ++i) printf("%.17g ", w[i]); } }\n'
    )
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    told = " ".join(repr(float(value)) for value in x.ravel())
    done = subprocess.run(
        [tmp_path / "main"], input=told, capture_output=True, text=True, check=True
    )
    w = np.array(done.stdout.split(), float).reshape(5, 6)
    ours = known.model().wrench(r, None if warm is None else np.full(5, 41.5))
    np.testing.assert_allclose(w, ours, rtol=0, atol=1e-8)


def test_a_refused_row_and_an_undone_matrix_are_exactly_the_boards_own() -> None:
    gain, prior = random_gains(7, 6)
    known = sensor(gain, prior, refused=("fx", "tz"), **WARM)
    (law,) = FORMATS["yarp"].decode(pieces("yarp", sheet_of(known))["ft_calibration.xml"], "x.xml")
    np.testing.assert_array_equal(law.matrix[[0, 5]], np.eye(6)[[0, 5]])
    assert law.about is not None
    assert law.about["keeps_workbench"] == ["fx", "tz"]
    content = pieces("yarp", sheet_of(known, undo=True))["ft_calibration.xml"]
    (before,) = FORMATS["yarp"].decode(content, "x.xml")
    np.testing.assert_array_equal(before.matrix, np.eye(6))
    assert not before.offset.any()
    assert before.temperature_gain is None


def test_undo_for_the_board_is_the_very_words_that_were_in_it() -> None:
    words = firmware.decode(firmware.encode(random_gains(8, 6)[1]), serial="SN900")
    # of rounded words the smallest full scale is one less, and other words would come out
    assert (firmware.smallest_full_scale(words.matrix) != words.full_scale).any()
    scale = [float(value) for value in words.full_scale]
    known = sensor(random_gains(8, 6)[0], words.matrix, full_scale=scale)
    made = pieces("firmware", sheet_of(known, undo=True))["matrix_SN900.txt"]
    again = firmware.decode(made.decode(), serial="SN900")
    np.testing.assert_array_equal(again.words, words.words)
    np.testing.assert_array_equal(again.full_scale, words.full_scale)


def test_rounding_to_words_changes_no_reading_by_more_than_is_printed() -> None:
    gain, prior = random_gains(9, 6)
    law = installed(sensor(gain, prior), "auto")
    said = FORMATS["firmware"].remarks(law)[0]
    made = pieces("firmware", Sheet({**ORIGIN, "undo": False}, (law,)))["matrix_SN900.txt"]
    held = firmware.decode(made.decode(), serial="SN900")
    corners = np.array(np.meshgrid(*[[-32767, 32767]] * 6)).reshape(6, -1).T
    worst = np.abs(corners @ (held.matrix - gain).T).max(axis=0)
    assert f"fx {worst[0]:.2g} N" in said
    assert f"tz {worst[5]:.2g} Nm" in said
    assert (worst > 0).all()


def test_channels_that_are_no_counts_are_refused_for_the_board() -> None:
    known = sensor(exact_secondary(), np.eye(6), logged="channels")
    with pytest.raises(SensorError, match="not ADC counts"):
        pieces("firmware", sheet_of(known))


def test_a_board_is_told_what_it_cannot_hold() -> None:
    said = " ".join(FORMATS["firmware"].remarks(installed(exact(**WARM), "auto")))
    assert "o is left out" in said
    assert "k is left out" in said


def test_a_neighbour_of_another_matrix_file_is_not_believed(tmp_path: Path) -> None:
    for name, content in pieces("firmware", sheet_of(exact())).items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "matrix_SN900.txt"
    assert exports.read(path)[0].sensor == "r_leg_ft_sensor"
    path.write_bytes(pieces("firmware", sheet_of(exact(), undo=True))[path.name])
    (law,) = exports.read(path)
    assert law.sensor == "SN900"
    assert law.workbench is None


@pytest.mark.parametrize("kind", SIX)
def test_every_file_says_where_it_comes_from(kind: str, tmp_path: Path) -> None:
    made = pieces(kind, sheet_of(exact(refused=("fy",))))
    for name, content in made.items():
        (tmp_path / name).write_bytes(content)
    (law,) = exports.read(tmp_path / [name for name in made if not name.endswith(".txt.json")][-1])
    assert law.about is not None
    assert law.about["keeps_workbench"] == ["fy"]
    assert law.about["verdicts"]["fy"] == "REFUSE"
    said = b"".join(made.values())
    if kind == "npz":
        import io

        with np.load(io.BytesIO(said)) as held:
            said = str(held["provenance"]).encode()
    for word in (b"0123abcd", b"2026-01-02", b"iCubPretend", b"r_leg_ft_sensor"):
        assert word in said


@pytest.mark.parametrize("kind", ["yarp", "ros", "ati", "c"])
def test_a_name_that_ends_comments_ends_none(kind: str, tmp_path: Path) -> None:
    known = exact(name='l--eg */ "<x>" /*', serial="--> */")
    made = pieces(kind, sheet_of(known))
    ((name, content),) = made.items()
    (tmp_path / name).write_bytes(content)
    (back,) = exports.read(tmp_path / name)
    assert back.sensor == 'l--eg */ "<x>" /*'
    assert back.workbench is not None
    assert back.workbench.name == "--> */"


@pytest.mark.parametrize("kind", SIX)
def test_a_file_that_reads_back_otherwise_is_not_written(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = written(exact(), tmp_path)
    right = FORMATS[kind]

    def wrong(content: bytes, where: str) -> tuple[Installed, ...]:
        (law,) = right.decode(content, where)
        return (replace(law, matrix=law.matrix * (1 + 1e-3)),)

    monkeypatch.setitem(FORMATS, kind, replace(right, decode=wrong))
    with pytest.raises(OutputError, match="reads back otherwise"):
        exports.export(source, kind, tmp_path / "out", offset="auto")
    assert not (tmp_path / "out").exists()


def test_one_sensor_that_cannot_be_written_leaves_no_file(tmp_path: Path) -> None:
    gain, prior = random_gains(3, 8)
    other = sensor(gain, prior, name="wrist", serial="SN901", logged="channels")
    source = tmp_path / "calibration.json"
    source.write_bytes(to_json(calibration(exact(), other)))
    result = run("export", source, "--to", "firmware", "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert "'wrist' has 8 channels" in result.stderr
    assert list(tmp_path.iterdir()) == [source]
    result = run("export", source, "--to", "firmware", "-o", tmp_path / "out",
                 "--sensor", "r_leg_ft_sensor")  # fmt: skip
    assert result.exit_code == 0, result.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"matrix_SN900.txt", "matrix_SN900.txt.json"}


def test_a_file_name_is_taken_and_a_calibration_never_overwritten(tmp_path: Path) -> None:
    source = written(exact(), tmp_path)
    result = run("export", source, "--to", "firmware", "-o", tmp_path / "matrix_new.txt")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "matrix_new.txt").exists()
    assert json.loads((tmp_path / "matrix_new.txt.json").read_bytes())["sensor"]["signal"]
    before = source.read_bytes()
    result = run("export", source, "--to", "json", "-o", source)
    assert result.exit_code == 1
    assert "overwritten" in result.stderr
    assert source.read_bytes() == before


def test_a_name_that_ends_in_a_slash_is_a_folder(tmp_path: Path) -> None:
    source = written(exact(), tmp_path)
    result = run("export", source, "--to", "c", "-o", f"{tmp_path}/robot.v1/")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "robot.v1" / "ft_calibration.h").is_file()
    assert run("export", source, "--to", "c", "-o", tmp_path / "robot.v2").exit_code == 0
    assert (tmp_path / "robot.v2").is_file()


def test_offsets_are_chosen_as_apply_does(tmp_path: Path) -> None:
    source = written(exact(), tmp_path)
    expected = {"auto": [20.0, -4.0, 64.0, 1.5, -0.25, 0.0], "first": [0.5] * 6, "zero": [0.0] * 6}
    for choice, offset in expected.items():
        out = tmp_path / "out.json"
        assert run("export", source, "--to", "json", "-o", out, "--offset", choice).exit_code == 0
        assert exports.read(out)[0].offset.tolist() == offset
    result = run("export", source, "--to", "json", "-o", tmp_path / "no.json", "--offset", "lsat")
    assert result.exit_code == 1
    assert "did you mean last" in result.stderr


def test_the_same_calibration_makes_the_same_bytes() -> None:
    for kind in SIX:
        assert pieces(kind, sheet_of(exact())) == pieces(kind, sheet_of(exact()))


RUBBISH = (
    b"", b"\xff\xfe\x00", b"{}", b"[1]", b"<a/>", b"a:\n  b: [1,", b"ftcal-sensor {}",
    b'<a><group name="FT_SECONDARY_CALIBRATION"><param name="x">(1, 2)</param></group></a>',
    b'ftcal-sensor {"sensor": "x"}\nx_law:\n  ros__parameters:\n    sensor_filter_chain: 3',
    b'{"format": "ftcal-export", "sensors": [{"about": {"sensor": "x"}, "gain": [[NaN]]}]}',
    b'{"format": "ftcal-calibration"}',
)  # fmt: skip


@pytest.mark.parametrize("suffix", [".xml", ".txt", ".yaml", ".cal", ".h", ".json", ".npz", ".pdf"])
def test_rubbish_is_one_line(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"file{suffix}"
    with pytest.raises(SensorError, match="cannot be read"):
        exports.read(path)
    for content in RUBBISH:
        path.write_bytes(content)
        with pytest.raises(SensorError) as raised:
            exports.read(path)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("kind", SIX)
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_refused_or_read_but_never_crashes(
    tmp_path: Path, kind: str, data: st.DataObject
) -> None:
    made = pieces(kind, sheet_of(exact(**WARM)))
    name = next(name for name in made if not name.endswith(".txt.json"))
    content = bytearray(made[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=3))
    (tmp_path / name).write_bytes(bytes(content))
    try:
        laws = exports.read(tmp_path / name)
    except SensorError:
        return
    assert all(np.isfinite(law.matrix).all() for law in laws)


def test_the_command_knows_every_format() -> None:
    (option,) = (option for option in main.commands["export"].params if option.name == "kind")
    assert isinstance(option.type, click.Choice)
    assert tuple(option.type.choices) == SIX


def test_the_example_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    written(exact(), tmp_path)
    (tmp_path / "example.py").write_text(example, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (change,) = runpy.run_path("example.py")["changes"]
    # S - I over full scale: fz doubles and takes four of ty
    assert change.full_scale[2] == pytest.approx(2048 + 4 * 64)


@pytest.mark.parametrize("kind", [kind for kind in SIX if kind != "npz"])
def test_golden_files(kind: str) -> None:
    np.testing.assert_array_equal(
        installed(exact(), "auto").on("wrench").matrix, exact_secondary()
    )  # nothing is rounded, so the text is the same on every machine
    assert np.linalg.cond(exact_prior()) < 1e3
    for name, content in pieces(kind, sheet_of(exact(**WARM))).items():
        check(f"export/{name if kind != 'json' else 'plain.json'}", content.decode())


def test_golden_output(tmp_path: Path) -> None:
    source = written(exact(refused=("fy",), **WARM), tmp_path)
    said = []
    for kind in SIX:
        result = run("export", source, "--to", kind, "-o", tmp_path / "out")
        assert result.exit_code == 0, result.output
        said.append(f"--to {kind}\n{result.stdout}")
    check("export/output.txt", "\n".join(said).replace(str(tmp_path), "HERE"))
