"""Tasks, one file each with its scripted expert. No task knows a robot.

Several tasks share `point_goal` and `pose_goal` (goals), `cube` (things and grips) and `settings` (starts of training
episodes, the cost of force). Throwing needs `throw_planner`.
"""
