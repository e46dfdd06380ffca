"""Recordings: episodes as files, written and read in our own format, as a LeRobotDataset v3, or as a Minari dataset."""
