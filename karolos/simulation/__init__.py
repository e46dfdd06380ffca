"""The interfaces of engine, robot and task; kinematics and URDF; the engines.

`interface` needs no engine. `bullet` implements it with PyBullet, `mujoco` with MuJoCo; `engines` makes their worlds.
"""
