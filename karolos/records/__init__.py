"""The run folder: the truth about one run, in files that anybody can read.

    spec.yaml       the spec as its author wrote it, if there was a file
    resolved.json   the spec with every default filled in
    run.json        id, experiment, name, seed, time, versions, command line, git commit
    code.diff       how the code differed from that commit
    state.json      state, steps, seconds, attempt, error; replaced as a whole
    tests.jsonl     one line per test
    events.jsonl    one line per thing that happened
    episodes.jsonl  one line per training episode, with what domain randomization drew
    tensorboard/    series
    checkpoints/    best and last
    export/         its policy for use without karolos, if somebody asked for it
    transfers.jsonl one line per test of its policy under changed settings
    labels.json     tags and note, whoever wrote them
    lock            held by the process that runs it, for as long as it lives

Only the process that holds the lock writes, but for transfers.jsonl and labels.json, which have locks of their own. The
state `lost` is never written: whoever reads `created` or `running` and finds the lock free knows that the process died.
"""

from .run_folder import RunFolder
from .scanning import paths, scan

__all__ = ["RunFolder", "paths", "scan"]
