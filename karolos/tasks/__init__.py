"""Tasks, one file each with its scripted expert. No task knows a robot.

Several tasks share `point_goal` and `pose_goal` (goals), `cube` (objects and grips) and `settings` (starts of training
episodes, cost of force). Throwing needs `throw_planner`.
"""
