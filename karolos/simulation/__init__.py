"""What an engine, a robot and a task are to each other; kinematics and URDF; the engines.

`interface` needs no engine. `bullet` implements it with PyBullet, `mujoco` with MuJoCo; `engines` makes their worlds.
"""
