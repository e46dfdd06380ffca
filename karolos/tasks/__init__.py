"""Tasks, one file each with its scripted expert. No task knows a robot.

`point_goal` and `cube` hold what several tasks share, `flight` and `throw_planner` what throwing needs.
"""
