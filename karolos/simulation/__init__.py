"""What an engine, a robot and a task are to each other; kinematics, URDF, the PyBullet world."""
