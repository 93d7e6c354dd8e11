"""A tool weighed from a ROS bag: attitudes from `tf`, `tf_static` and `PoseStamped`."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.cli import main
from ftcal.errors import DataError, FtcalError, LogError
from ftcal.frame_tree import FrameTree, rotation_from_quaternion, turns
from ftcal.logs.ros_poses import Listener
from ftcal.logs.ros_topic import Topic, batch
from ftcal.payload import estimate
from ftcal.pose_bags import BagLayout, read_bag
from ftcal.poses import STANDARD_GRAVITY
from ftcal.recording import Signal
from ftcal.spatial import rotation_about
from ros_bags import (
    START,
    Message,
    definition,
    pose,
    ros2,
    transforms,
    wrench,
    write_bag,
    write_db3,
    write_mcap,
    write_mcap_objects,
)

WRENCH, TF, POSE = "geometry_msgs/WrenchStamped", "tf2_msgs/TFMessage", "geometry_msgs/PoseStamped"
MASS, CENTRE = 0.8, np.array([0.01, -0.02, 0.05])
OFFSET = np.array([5.0, -1.0, 8.0, 0.4, -0.6, -0.2])
BOLT = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
"""The sensor on the flange, turned by 0.6 rad about z."""
UPSIDE_DOWN = (1.0, 0.0, 0.0, 0.0)
"""The robot hangs from the ceiling: its base frame has z down."""
RATE = 0.1
"""How fast both joints turn [rad/s], slow enough to be at rest."""
TO_SENSOR = BagLayout(frames=("world", "ft"))


def about(axis: int, angle: float) -> list[float]:
    """Return the quaternion x y z w of a turn about an axis."""
    q = [0.0, 0.0, 0.0, float(np.cos(angle / 2))]
    q[axis] = float(np.sin(angle / 2))
    return q


def felt(W_R_S: np.ndarray) -> list[float]:
    """Return what the sensor reads of the tool."""
    g = MASS * -STANDARD_GRAVITY * W_R_S[2]
    return [*(np.concatenate([g, np.cross(CENTRE, g)]) + OFFSET).tolist()]


def orientation(t: float) -> np.ndarray:
    """Return sensor to world after t seconds, by axes and angles."""
    flange = rotation_about(np.array([1.0, 0, 0]), np.array(RATE * t)) @ rotation_about(
        np.array([0, 1.0, 0]), np.array(0.7 * RATE * t)
    )
    upside_down, bolt = np.diag([1.0, -1, -1]), rotation_about(np.array([0, 0, 1.0]), np.array(0.6))
    return np.asarray(upside_down @ flange @ bolt)


def arm(*, seconds: float = 40.0, ros1: bool = False, slash: str = "") -> list[Message]:
    """Return what an arm on the ceiling logs: two joints at 50 Hz and 20 Hz, a wrench at 100 Hz."""
    out: list[Message] = [
        ("/tf_static", TF, START, transforms(
            (0, f"{slash}world", f"{slash}base_link", UPSIDE_DOWN),
            (0, f"{slash}flange", f"{slash}ft", BOLT.tolist()), ros1=ros1)),
    ]  # fmt: skip
    for n in range(round(seconds * 100)):
        stamp, t = START + n * 10_000_000, n / 100
        two: list[tuple[int, str, str, Sequence[float]]] = [
            (stamp, f"{slash}base_link", f"{slash}elbow", about(0, RATE * t)),
            (stamp, f"{slash}elbow", f"{slash}flange", about(1, 0.7 * RATE * t)),
        ]
        due = [one for one, every in zip(two, (2, 5), strict=True) if n % every == 0]
        if due:
            out.append(("/tf", TF, stamp + 3_000_000, transforms(*due, ros1=ros1)))
        force = wrench(stamp, felt(orientation(t)), ros1=ros1)
        out.append(("/wrist", WRENCH, stamp + 1_000_000, force))
    return sorted(out, key=lambda message: message[2])


def by_mcap(path: Path) -> Path:
    return write_mcap(path / "arm.mcap", arm())


def by_sqlite(path: Path) -> Path:
    return write_db3(path / "arm.db3", arm())


def ros1(path: Path) -> Path:
    return write_bag(path / "arm.bag", arm(ros1=True, slash="/"))


def by_mcap_ros2(path: Path) -> Path:
    """Write half of it as objects, packed by another library."""

    def header(stamp: int, frame: str) -> dict[str, object]:
        return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}

    def turned(stamp: int, parent: str, child: str, q: Sequence[float]) -> dict[str, object]:
        rotation = dict(zip("xyzw", q, strict=True))
        zero = dict.fromkeys("xyz", 0.0)
        return {"header": header(stamp, parent), "child_frame_id": child,
                "transform": {"translation": zero, "rotation": rotation}}  # fmt: skip

    messages: list[tuple[str, str, int, dict[str, object]]] = [
        ("/tf_static", TF, START, {"transforms": [turned(0, "world", "base_link", UPSIDE_DOWN),
                                                  turned(0, "flange", "ft", BOLT.tolist())]})
    ]  # fmt: skip
    for n in range(2000):
        stamp, t = START + n * 20_000_000, n / 50
        joints = [turned(stamp, "base_link", "elbow", about(0, RATE * t)),
                  turned(stamp, "elbow", "flange", about(1, 0.7 * RATE * t))]  # fmt: skip
        messages.append(("/tf", TF, stamp, {"transforms": joints}))
        f = felt(orientation(t))
        parts = (dict(zip("xyz", part, strict=True)) for part in (f[:3], f[3:]))
        force = dict(zip(("force", "torque"), parts, strict=True))
        messages.append(("/wrist", WRENCH, stamp, {"header": header(stamp, "ft"), "wrench": force}))
    return write_mcap_objects(path / "arm.mcap", messages)


@pytest.mark.parametrize("write", [by_mcap, by_sqlite, ros1, by_mcap_ros2])
def test_the_tool_is_weighed_from_any_bag(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    """Linear interpolation of 0.1 rad/s between stamps of 50 ms misses by 3e-6 of gravity."""
    poses = read_bag(write(tmp_path), TO_SENSOR)
    found = estimate(poses)
    assert found.refused == ()
    np.testing.assert_allclose(found.mass, MASS, rtol=1e-4)
    np.testing.assert_allclose(found.centre, CENTRE, atol=1e-5)
    np.testing.assert_allclose(found.offset, OFFSET, atol=1e-3)


def test_poses_of_a_topic_say_the_same(tmp_path: Path) -> None:
    messages = []
    for n in range(400):
        stamp, t = START + n * 100_000_000, n / 10
        q = about(0, RATE * t)
        messages += [("/ee", POSE, stamp, pose(stamp, q)),
                     ("/wrist", WRENCH, stamp, wrench(stamp, felt(rotation_from_quaternion(
                         np.array([q]))[0])))]  # fmt: skip
    file = write_mcap(tmp_path / "a.mcap", messages)
    poses = read_bag(file, BagLayout(pose="/ee"))
    np.testing.assert_allclose(estimate(poses).mass, MASS, rtol=1e-9)
    with pytest.raises(LogError, match="no topic of poses '/ea'; did you mean /ee"):
        read_bag(file, BagLayout(pose="/ea"))
    with pytest.raises(DataError, match=r"say --tf BASE SENSOR \(none\) or --pose TOPIC \(/ee\)"):
        read_bag(file, BagLayout())


def test_a_base_below_the_root_is_reached_through_their_common_frame(tmp_path: Path) -> None:
    """Seen from the base that hangs upside down, gravity points up: the reaction is read."""
    found = estimate(read_bag(by_mcap(tmp_path), BagLayout(frames=("base_link", "ft"))))
    assert found.sign == -1
    np.testing.assert_allclose(found.mass, MASS, rtol=1e-4)


def refused(tmp_path: Path, messages: Sequence[Message], layout: BagLayout = TO_SENSOR) -> str:
    """Return what is said of the bag, one line."""
    still = ("/wrist", WRENCH, START, wrench(START, [0.0] * 6))
    with pytest.raises(FtcalError) as error:
        read_bag(write_mcap(tmp_path / "a.mcap", [still, *messages]), layout)
    return str(error.value)


def moved(
    parent: str, child: str, turned: Sequence[float], *, late: int = 0, topic: str = "/tf"
) -> list[Message]:
    """Return transforms that turn by `turned` [rad], 10 ms apart."""
    stamps = [START + n * 10_000_000 + late for n in range(len(turned))]
    return [
        (topic, TF, stamp, transforms((stamp, parent, child, about(0, angle))))
        for stamp, angle in zip(stamps, turned, strict=True)
    ]


def test_unknown_frames_are_named_with_those_there_are(tmp_path: Path) -> None:
    layout = BagLayout(frames=("wrold", "tool"))
    said = refused(tmp_path, moved("world", "ft", [0.0, 0.1]), layout)
    assert "no frame 'wrold'; did you mean world?" in said
    assert "no frame 'tool'" in said
    assert "frames are ft, world" in said


def test_frames_that_nothing_joins_are_told_with_their_roots(tmp_path: Path) -> None:
    said = refused(tmp_path, [*moved("world", "arm", [0, 0.1]), *moved("flange", "ft", [0, 0.1])])
    assert "nothing joins 'world' (its tree begins at 'world') and 'ft' (at 'flange')" in said


def test_a_frame_with_two_parents_is_refused(tmp_path: Path) -> None:
    said = refused(tmp_path, [*moved("world", "ft", [0, 0.1]), *moved("arm", "ft", [0, 0.1])])
    assert "frame 'ft' hangs on 'arm' and on 'world'" in said


def test_a_loop_is_refused_by_name(tmp_path: Path) -> None:
    said = refused(tmp_path, [*moved("a", "b", [0]), *moved("b", "c", [0]), *moved("c", "a", [0])])
    assert re.search("frames hang on each other: (a -> b -> c|b -> c -> a|c -> a -> b)", said)
    assert "frames hang on each other: a -> a" in refused(tmp_path, moved("a", "a", [0, 0.1]))


@pytest.mark.parametrize("late", [0, 1_000_000])
def test_two_publishers_of_one_transform_are_refused(tmp_path: Path, late: int) -> None:
    one, other = moved("world", "ft", [0.0] * 30), moved("world", "ft", [0.4] * 30, late=late)
    said = refused(tmp_path, sorted([*one, *other], key=lambda message: message[2]))
    assert "transform world -> ft" in said
    assert "two publishers send it" in said


def test_a_static_transform_said_twice_is_one(tmp_path: Path) -> None:
    still = moved("world", "base_link", [0.2] * 3, topic="/tf_static")
    said = refused(tmp_path, [*still, *moved("base_link", "ft", [0.0])])
    assert "are at no time all known" in said  # one sample of a joint says nothing of other times
    differing = moved("world", "ft", [0.2, 0.3], topic="/tf_static")
    assert "static, but said 5.73 deg apart" in refused(tmp_path, differing)
    both = [*moved("world", "ft", [0.2], topic="/tf_static"), *moved("world", "ft", [0.1])]
    assert "world -> ft is static and moves" in refused(tmp_path, both)
    assert "nothing between 'world' and 'ft' moves" in refused(
        tmp_path, moved("world", "ft", [0.2], topic="/tf_static")
    )


def test_what_is_no_quaternion_is_named(tmp_path: Path) -> None:
    for q, told in (
        ((0.0, 0.0, 0.0, 0.0), "message 2: quaternion of norm 0, not 1"),
        ((0.0, 0.6, 0.0, 0.6), "message 2: quaternion of norm 0.8485, not 1"),
        ((0.0, float("nan"), 0.0, 1.0), "message 2: quaternion y is nan"),
        ((0.0, 1e300, 0.0, 1.0), "message 2: quaternion of norm inf, not 1"),
    ):
        bad = ("/tf", TF, START + 10**9, transforms((START + 10**9, "world", "ft", q)))
        said = refused(tmp_path, [*moved("world", "ft", [0.0]), bad])
        assert f"transform world -> ft, {told}" in said


def test_time_that_goes_back_is_refused(tmp_path: Path) -> None:
    back = [("/tf", TF, START + n, transforms((START + 9 - n, "world", "ft", about(0, 0.1))))
            for n in range(3)]  # fmt: skip
    assert "message 2: time goes back by 0.000000 s" in refused(tmp_path, back)


def test_a_bag_without_a_wrench_is_refused(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", moved("world", "ft", [0.0, 0.1]))
    with pytest.raises(LogError, match="no WrenchStamped message in it"):
        read_bag(file, TO_SENSOR)


def test_clocks_that_never_meet_are_refused(tmp_path: Path) -> None:
    turned = moved("world", "ft", [0.0, 0.1, 0.2], late=10**9)
    assert "no wrench within the time of the attitude; record both" in refused(tmp_path, turned)


def test_a_broken_wrench_is_named(tmp_path: Path) -> None:
    broken = ("/wrist", WRENCH, START + 1, wrench(START + 1, [0, 0, 1e30, 0, 0, 0]))
    said = refused(tmp_path, [broken, *moved("world", "ft", [0.0, 0.1])])
    assert "/wrist, message 2: fz is 1e+30, which no sensor reads" in said


@settings(max_examples=30, deadline=None)
@given(flips=st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=4))
def test_broken_bytes_are_read_or_refused(flips: list[tuple[float, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = write_db3(Path(folder) / "a.db3", arm(seconds=0.2))
        raw = bytearray(file.read_bytes())
        for place, bits in flips:
            raw[round(place * (len(raw) - 1))] ^= bits
        file.write_bytes(raw)
        with suppress(FtcalError):
            read_bag(file, TO_SENSOR)


def test_several_wrenches_are_asked_for(tmp_path: Path) -> None:
    other = ("/ankle", WRENCH, START, wrench(START, [0.0] * 6))
    turned = moved("world", "ft", [0.0, 0.1])
    assert "2 wrenches, /ankle, /wrist; say --topic" in refused(tmp_path, [other, *turned])
    layout = BagLayout(frames=("world", "ft"), topic="/wrst")
    assert "no wrench '/wrst'; did you mean /wrist" in refused(tmp_path, [other, *turned], layout)


angles = st.floats(-3.0, 3.0)


@given(st.lists(st.tuples(st.integers(0, 2), angles), min_size=1, max_size=4), st.integers(0, 4))
def test_a_chain_is_the_product_of_its_turns(turned: list[tuple[int, float]], base: int) -> None:
    """Half of the chain climbs from the base to the root, the other half goes down."""
    base = min(base, len(turned) - 1)
    links = [f"link {n}" for n in range(len(turned) + 1)]
    stamps = START + np.arange(3)
    tree = FrameTree.of("test", [
        turns("test", parent, child,
              Signal("", tuple("xyzw"), stamps, np.array([about(axis, angle)] * 3)))
        for (axis, angle), parent, child in zip(turned, links[:-1], links[1:], strict=True)
    ])  # fmt: skip
    axes = np.eye(3)
    expected = np.eye(3)
    for axis, angle in turned[base:]:
        expected = expected @ rotation_about(axes[axis], np.array(angle))
    down = tree.attitude(links[base], links[-1])
    np.testing.assert_allclose(down.values, np.tile(expected.ravel(), (3, 1)), atol=1e-12)
    up = tree.attitude(links[-1], links[base])
    np.testing.assert_allclose(up.values, np.tile(expected.T.ravel(), (3, 1)), atol=1e-12)


def test_the_command_weighs_a_bag(tmp_path: Path) -> None:
    file = by_mcap(tmp_path)
    words = ["payload", str(file), "--tf", "world", "ft"]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 0, run.output
    assert "wrench from /wrist, rotation from tf world -> ft" in run.output
    slower = CliRunner().invoke(main, [*words, "--steady", "0.001"])
    assert "never turns slower" in slower.output
    assert CliRunner().invoke(main, [*words, "--unit", "g"]).exit_code == 2
    table = tmp_path / "a.csv"
    table.write_text("time,fx\n0,1\n")
    assert CliRunner().invoke(main, ["payload", str(table), "--pose", "/ee"]).exit_code == 2


names = st.sampled_from(["a", "bb", "ccc", "d" * 9, "/e"])
parts = st.tuples(st.integers(0, 2**31 - 1), names, names, st.tuples(*[st.floats(width=64)] * 4))


@settings(deadline=None)
@given(st.lists(st.lists(parts, max_size=4), min_size=1, max_size=12), st.booleans())
def test_transforms_read_at_once_are_those_of_rosbags(
    messages: list[list[tuple[int, str, str, tuple[float, ...]]]], ros1: bool
) -> None:
    topic = Topic("/tf", ros2(TF), definition(TF, ros1=ros1), "ros1msg" if ros1 else "ros2msg",
                  "ros1" if ros1 else "cdr")  # fmt: skip
    packed = [transforms(*some, ros1=ros1) for some in messages]
    same = batch(topic, packed, range(len(packed)))
    at_once, one_by_one = Listener(topic, "test"), Listener(topic, "test")
    at_once.hear(same)
    one_by_one.one_by_one(same, np.arange(len(same)))
    assert said(at_once) == said(one_by_one)


def said(listener: Listener) -> list[tuple[str, str, int, int, bytes]]:
    """Return one line a transform, bit for bit, in any order."""
    return sorted(
        (*frames, int(arrival[n]), int(stamps[n]), values[n].tobytes())
        for frames, heard in listener.heard.items()
        for arrival, stamps, values in heard for n in range(len(stamps))
    )  # fmt: skip
