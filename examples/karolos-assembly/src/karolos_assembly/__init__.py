"""A plug and a jig from files, and the task `seat_plug`, a plugin of karolos."""
