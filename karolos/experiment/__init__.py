"""One run: a spec and a seed from an empty folder to the end, with its files, its events and how it resumes."""
