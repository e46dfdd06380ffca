"""Tasks, one file each with its scripted expert. No task knows a robot."""
