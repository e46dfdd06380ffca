"""One run: a spec and a seed from the checks and an empty folder to the end, with its process, files and events."""
