"""One run: a spec and a seed from an empty folder to the end, what is written meanwhile, and how it resumes."""
