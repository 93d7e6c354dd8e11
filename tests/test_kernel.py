"""The tracer folds, the machine code is accurate, for every width of vectors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcal import jit
from ftcal.dynamics import expected_wrenches
from ftcal.kernel import WrenchKernel, compile_wrenches
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.program import Program
from ftcal.trace import Trace, Value
from ftcal.tree import grow
from ftcal.urdf import read_robot


def test_zero_and_one_vanish() -> None:
    x = Trace().input(0)
    assert 0.0 * x == 0.0
    assert x + 0.0 is x
    assert 1.0 * x is x
    assert x - x == 0.0
    assert 0.0 - (0.0 - x) is x


def test_equal_expressions_are_one_node() -> None:
    trace = Trace()
    x, y = trace.input(0), trace.input(1)
    assert x * y + 1.0 is 1.0 + y * x
    assert (-x) * y is -(x * y)
    assert x + (-y) is x - y
    assert -(x - y) is y - x


def test_constant_and_node_of_the_same_number_are_not_confused() -> None:
    trace = Trace()
    x, one = trace.input(0), trace.input(1)
    assert isinstance(one, Value)
    assert one.id == 1
    assert x + float(one.id) is not x + one


def test_angles_without_a_signal_fold() -> None:
    assert Trace().sin_cos(0.5) == (math.sin(0.5), math.cos(0.5))


@pytest.fixture(scope="module", params=[2, 4, 8])
def sin_cos(request: pytest.FixtureRequest) -> WrenchKernel:
    """Sine and cosine of one signal, in the place of a wrench."""
    trace = Trace()
    s, c = trace.sin_cos(trace.input(0))
    program = Program(trace, [s, c, 1.0, s * c, trace.input(0), -s], request.param)
    module = jit.compile_ir(program.text())
    return WrenchKernel(1, program.rows, len(program.sections), program.width, module)


def ulps(value: np.ndarray, exact: np.ndarray) -> float:
    return float(np.max(abs(value - exact) / np.spacing(abs(exact).astype(np.float64))))


def test_sine_and_cosine_are_right_to_the_last_place_or_so(sin_cos: WrenchKernel) -> None:
    rng = np.random.default_rng(0)
    near_zeros = np.arange(-2000, 2000) * (np.pi / 2)
    angles = np.concatenate(
        [
            rng.uniform(-4.0, 4.0, 200_000),
            rng.uniform(-1e5, 1e5, 200_000),
            near_zeros,
            np.nextafter(near_zeros, 1e9),
            rng.normal(size=1000) * 1e-9,
        ]
    )
    (table,) = sin_cos([angles], len(angles))
    exact = angles.astype(np.longdouble)  # on x86 the reference has 11 bits more
    assert ulps(table[:, 0], np.sin(exact)) < 1.5
    assert ulps(table[:, 1], np.cos(exact)) < 1.5


def test_outputs_may_be_constants_and_inputs(sin_cos: WrenchKernel) -> None:
    angles = np.linspace(-3.0, 3.0, 11)
    (table,) = sin_cos([angles], 11)
    np.testing.assert_array_equal(table[:, 2], 1.0)
    np.testing.assert_array_equal(table[:, 4], angles)
    np.testing.assert_array_equal(table[:, 5], -table[:, 0])


def test_what_is_not_a_number_stays_so(sin_cos: WrenchKernel) -> None:
    (table,) = sin_cos([np.array([np.nan, np.inf, 0.0])], 3)
    assert np.isnan(table[:2, :2]).all()
    np.testing.assert_array_equal(table[2, :2], [0.0, 1.0])


@given(angle=st.floats(-1e5, 1e5))
def test_sine_and_cosine_lie_on_the_circle(sin_cos: WrenchKernel, angle: float) -> None:
    (table,) = sin_cos([np.array([angle])], 1)
    assert math.hypot(*table[0, :2]) == pytest.approx(1.0, rel=4e-16)


@pytest.mark.parametrize("width", [2, 4, 8])
def test_every_width_of_vectors_gives_the_same(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    icub_models = pytest.importorskip("icub_models")
    robot = read_robot(icub_models.get_model_file("iCubGazeboV2_7"))
    rng = np.random.default_rng(0)
    signals = rng.normal(size=(3, 131, len(robot.moving_joints)))
    motion = Motion(np.arange(131.0), robot.moving_joints, *signals)
    contact, sensors = FixedContact("l_sole"), ["r_leg_ft", "l_leg_ft"]
    expected = expected_wrenches(robot, motion, contact, sensors, engine="numpy")
    monkeypatch.setattr(jit, "vector_width", lambda: width)
    tree = grow(robot, "l_sole", sensors)
    where = motion.columns(tree.joints)
    columns = [signal[:, k] for k in where for signal in signals]
    results = compile_wrenches(tree, STANDARD_GRAVITY)(columns, 131)
    for name, result in zip(sensors, results, strict=True):
        np.testing.assert_allclose(
            result, expected[name], rtol=0, atol=1e-12 * abs(expected[name]).max()
        )
