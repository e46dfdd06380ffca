import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from karolos.robots.panda import Panda
from karolos.simulation.kinematics import downward

ARM = Panda(Panda.Settings.model_validate({}))
CHAIN = ARM.chain
poses = st.tuples(*(st.floats(low, high) for low, high in zip(ARM.limits.lower, ARM.limits.upper, strict=True)))


@given(poses, poses)
def test_tool_velocity_is_the_derivative_of_its_position_and_the_jacobian_times_the_rates(pose, rates):
    step, at = 1e-6, CHAIN.forward(pose)
    ahead, behind = (CHAIN.forward(np.add(pose, step * sign * np.array(rates))).tool.position for sign in (1, -1))
    velocity = CHAIN.velocity(at, rates)
    np.testing.assert_allclose(velocity, np.subtract(ahead, behind) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(velocity, CHAIN.jacobian(at)[:3] @ np.array(rates), atol=1e-12)


@given(poses)
def test_tool_frame_is_a_rotation(pose):
    tool = CHAIN.forward(pose).tool
    frame = np.array([tool.x, tool.y, tool.z])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0)


@given(st.tuples(st.floats(0.4, 0.65), st.floats(-0.2, 0.2), st.floats(0.05, 0.35)), st.floats(-0.8, 0.8))
def test_repeated_steps_bring_the_tool_there_pointing_down_with_the_yaw(target, yaw):
    joints = list(ARM.model.home)
    for _ in range(30):
        change = CHAIN.step(CHAIN.forward(joints), downward(target, yaw), [0.0] * 7)
        joints = [value + turn for value, turn in zip(joints, change, strict=True)]
    tool = CHAIN.forward(joints).tool
    np.testing.assert_allclose(tool.position, target, atol=1e-4)
    np.testing.assert_allclose(tool.z, (0, 0, -1), atol=1e-3)
    np.testing.assert_allclose(tool.x, (np.cos(yaw), np.sin(yaw), 0), atol=1e-3)


def test_posture_does_not_move_the_tool():
    at = CHAIN.forward(ARM.model.home)
    change = CHAIN.step(at, downward(at.tool.position, 0.0), [0.02, 0.0, -0.02, 0.0, 0.0, 0.0, 0.0])
    moved = CHAIN.forward([value + turn for value, turn in zip(ARM.model.home, change, strict=True)])
    assert np.linalg.norm(change) > 0.01
    assert np.linalg.norm(np.subtract(moved.tool.position, at.tool.position)) < 1e-4
