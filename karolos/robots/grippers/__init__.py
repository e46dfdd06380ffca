"""Grippers, one file each, which are mounted on arms. No gripper knows an arm."""
