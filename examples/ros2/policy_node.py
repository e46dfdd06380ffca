"""A ROS 2 node that runs a bundle of karolos on an arm with `forward_position_controller`. Never tried on hardware.

`python3 policy_node.py BUNDLE 0.5 0.1 0.15`, with the goal's numbers. It subscribes to `joint_states`, to
`force_torque_sensor_broadcaster/wrench` (at the tool, in its frame), and to `object_pose` and `object_twist` (in the
world's frame of the bundle). `Cell` needs no ROS: tests/deploy/test_ros2_node.py tests it.
"""

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
    """Turns messages into set points. Raises Fault when the robot must be stopped.

    Args:
        bundle: folder of the bundle.
        goal: desired goal (g,).
        publish: is given joint positions in the bundle's order, and the opening of the gripper or None.
    """

    def __init__(self, bundle: str, goal: Sequence[float], publish: Callable[[list[float], Any], None]) -> None:
        self.bundle, self.goal, self.publish = Bundle(bundle), np.array(goal, np.float32), publish
        contract = self.bundle.contract
        if contract["control"]["mode"] == "impedance":
            raise Fault("wrong controller", "a spring cannot be told positions; use force_mode_controller")
        self.names = [joint["name"] for joint in contract["joints"]]
        self.watch = Watch(contract, contract["limits"]["late"])
        self.observer, self.motion = Observer(contract), Motion(contract, self.bundle.chain)
        self.period, self.due = 1 / contract["control"]["rate"], -np.inf
        self.wrench, self.opening, self.begun = np.zeros(6), 1.0, False
        self.measured: dict[str, Any] = {}
        self.joints: tuple[float, Any, Any] | None = None

    def on_joints(self, stamp: float, names: Sequence[str], positions: Sequence[float], rates: Sequence[float]) -> None:
        """A JointState, whose order is another one."""
        order = [list(names).index(name) for name in self.names]
        self.joints = stamp, np.array(positions)[order], np.array(rates)[order]

    def on_pose(self, position: Sequence[float], quaternion: Sequence[float]) -> None:
        """The object's pose: the observation has the first two columns of its rotation matrix."""
        x, y, z, w = quaternion
        first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
        self.measured |= {"object_position": np.array(position), "object_rotation": np.array([*first, *second])}

    def on_twist(self, linear: Sequence[float], angular: Sequence[float]) -> None:
        self.measured |= {"object_velocity": np.array(linear), "object_angular_velocity": np.array(angular)}

    def cycle(self, now: float) -> None:
        """What a timer calls `RATE` times per second."""
        if self.joints is None or set(self.observer.measured) - set(self.measured):
            return  # something was never told
        reading = Reading(*self.joints, self.wrench, self.opening, dict(self.measured))
        at = self.bundle.chain.at(reading.positions)
        if not self.begun:
            self.watch.start(reading)
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
    """Spin until a fault; the controller then holds the last position."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    def numbers(one: Any, names: str = "xyz") -> list[float]:
        return [getattr(one, name) for name in names]

    rclpy.init()
    node = rclpy.create_node("karolos_policy")
    arm = node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 1)
    hand = node.create_publisher(Float64MultiArray, "gripper/commands", 1)

    def publish(positions: list[float], opening: float | None) -> None:
        arm.publish(Float64MultiArray(data=positions))
        hand.publish(Float64MultiArray(data=[] if opening is None else [opening]))

    def on_joints(told: Any) -> None:
        stamp = told.header.stamp.sec + 1e-9 * told.header.stamp.nanosec
        cell.on_joints(stamp, told.name, told.position, told.velocity)

    def on_wrench(told: Any) -> None:
        cell.wrench = np.array(numbers(told.wrench.force) + numbers(told.wrench.torque))

    def on_pose(told: Any) -> None:
        cell.on_pose(numbers(told.pose.position), numbers(told.pose.orientation, "xyzw"))

    def on_twist(told: Any) -> None:
        cell.on_twist(numbers(told.twist.linear), numbers(told.twist.angular))

    cell = Cell(arguments[0], [float(one) for one in arguments[1:]], publish)
    node.create_subscription(JointState, "joint_states", on_joints, 1)
    node.create_subscription(WrenchStamped, "force_torque_sensor_broadcaster/wrench", on_wrench, 1)
    node.create_subscription(PoseStamped, "object_pose", on_pose, 1)
    node.create_subscription(TwistStamped, "object_twist", on_twist, 1)
    node.create_timer(1 / RATE, lambda: cell.cycle(node.get_clock().now().nanoseconds * 1e-9))
    try:
        rclpy.spin(node)
    except Fault as fault:
        sys.exit(f"stopped: {fault}")


if __name__ == "__main__":
    main(sys.argv[1:])
