"""The robot `desk_arm`, a plugin of karolos."""
