"""A ROS 2 node that runs a bundle of karolos on an arm with `forward_position_controller`. Never tried on hardware.

    ros2 run ... or: python3 policy_node.py BUNDLE 0.5 0.1 0.15

Subscribes: `joint_states` (sensor_msgs/JointState), `force_torque_sensor_broadcaster/wrench` (WrenchStamped, at the
tool, in its frame), `object_pose` and `object_twist` (PoseStamped, TwistStamped, in the world's frame of the bundle).
Publishes: `forward_position_controller/commands` and `gripper/commands` (Float64MultiArray).
It needs rclpy and karolos-deploy; `Cell` needs no ROS and is what tests/deploy/test_ros2_node.py tests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from karolos_deploy import Bundle, Fault, Reading
from karolos_deploy.faults import Watch
from karolos_deploy.motion import Motion
from karolos_deploy.readings import Observer

RATE = 250.0
"""Set points per second."""


class Cell:
    """Turns messages into set points. Raises Fault when the robot must be stopped; then nothing may be published.

    Args:
        bundle: folder of the bundle.
        goal: desired goal (g,).
        publish: is given joint positions in the bundle's order, and the opening of the gripper or None.
    """

    def __init__(
        self, bundle: str, goal: Sequence[float], publish: Callable[[list[float], float | None], None]
    ) -> None:
        self.bundle, self.goal, self.publish = Bundle(bundle), np.array(goal, np.float32), publish
        contract = self.bundle.contract
        if contract["control"]["mode"] == "impedance":
            raise Fault(
                "wrong controller", "positions cannot be told to a policy with a spring; use force_mode_controller"
            )
        self.names = [joint["name"] for joint in contract["joints"]]
        self.watch = Watch(contract, contract["limits"]["late"])
        self.observer, self.motion = Observer(contract), Motion(contract, self.bundle.chain)
        self.period, self.due = 1 / contract["control"]["rate"], -np.inf
        self.wrench, self.opening = np.zeros(6), 1.0
        self.measured: dict[str, np.ndarray] = {}
        self.joints: tuple[float, np.ndarray, np.ndarray] | None = None
        self.begun = False

    def on_joints(self, stamp: float, names: Sequence[str], positions: Sequence[float], rates: Sequence[float]) -> None:
        """A JointState, whose order is another one."""
        order = [list(names).index(name) for name in self.names]
        self.joints = stamp, np.array(positions)[order], np.array(rates)[order]

    def on_pose(self, position: Sequence[float], quaternion: Sequence[float]) -> None:
        """A PoseStamped of the object: the observation has the first two columns of its rotation matrix."""
        x, y, z, w = quaternion
        first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
        self.measured |= {"object_position": np.array(position), "object_rotation": np.array([*first, *second])}

    def on_twist(self, linear: Sequence[float], angular: Sequence[float]) -> None:
        """A TwistStamped of the object."""
        self.measured |= {"object_velocity": np.array(linear), "object_angular_velocity": np.array(angular)}

    def cycle(self, now: float) -> None:
        """What a timer calls `RATE` times per second."""
        if self.joints is None or set(self.observer.measured) - set(self.measured):
            return  # something was never told
        reading = Reading(*self.joints, self.wrench, self.opening, dict(self.measured))
        at = self.bundle.chain.at(reading.positions)
        if not self.begun:
            self.watch.start(reading, self.bundle.contract)
            self.motion.reset(reading.positions, at)
            self.begun = True
        if self.watch.look(reading, now):
            self.observer.feel(reading)
            self.watch.tool(at, self.observer.wrench)
        if now >= self.due:
            self.due = max(self.due + self.period, now + self.period / 2)
            observation = self.observer(reading, at, self.motion.set_point_from(at))
            self.motion.plan(self.bundle.policy(observation, self.goal), reading.positions, at, now)
        point = self.motion.at(now, 1 / RATE)
        self.publish(self.motion.positions.tolist(), point.opening)


def main(arguments: list[str]) -> None:
    """Spin until a fault."""
    import rclpy  # noqa: PLC0415
    from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped  # noqa: PLC0415
    from sensor_msgs.msg import JointState  # noqa: PLC0415
    from std_msgs.msg import Float64MultiArray  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node("karolos_policy")
    arm = node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 1)
    hand = node.create_publisher(Float64MultiArray, "gripper/commands", 1)

    def publish(positions: list[float], opening: float | None) -> None:
        arm.publish(Float64MultiArray(data=positions))
        if opening is not None:
            hand.publish(Float64MultiArray(data=[opening]))

    cell = Cell(arguments[0], [float(one) for one in arguments[1:]], publish)

    def numbers(vector: Any, names: str = "xyz") -> list[float]:
        return [getattr(vector, name) for name in names]

    def on_wrench(message: Any) -> None:
        cell.wrench = np.array(numbers(message.wrench.force) + numbers(message.wrench.torque))

    def on_joints(told: Any) -> None:
        cell.on_joints(
            told.header.stamp.sec + 1e-9 * told.header.stamp.nanosec, told.name, told.position, told.velocity
        )

    node.create_subscription(JointState, "joint_states", on_joints, 1)
    node.create_subscription(WrenchStamped, "force_torque_sensor_broadcaster/wrench", on_wrench, 1)
    for kind, topic, take in (
        (
            PoseStamped,
            "object_pose",
            lambda m: cell.on_pose(numbers(m.pose.position), numbers(m.pose.orientation, "xyzw")),
        ),
        (TwistStamped, "object_twist", lambda m: cell.on_twist(numbers(m.twist.linear), numbers(m.twist.angular))),
    ):
        node.create_subscription(kind, topic, take, 1)
    node.create_timer(1 / RATE, lambda: cell.cycle(node.get_clock().now().nanoseconds * 1e-9))
    try:
        rclpy.spin(node)
    except Fault as fault:  # the controller holds the last position
        sys.exit(f"stopped: {fault}")


if __name__ == "__main__":
    main(sys.argv[1:])
