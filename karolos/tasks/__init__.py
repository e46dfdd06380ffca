"""Tasks, one file each with its scripted expert. No task knows a robot.

What several tasks share: `point_goal`, `pose_goal` (goals), `cube` (things), `carrying` (grips), `starts` (of training
episodes), `force_penalty`. What throwing needs: `flight`, `throw_planner`.
"""
