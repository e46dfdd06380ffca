"""The run folder: the truth about one run, in files that any program can read.

    spec.yaml       the spec as its author wrote it, if there was a file
    resolved.json   the spec with every default filled in
    run.json        id, experiment, name, seed, time, versions, command line, git commit
    code.diff       how the code differed from that commit
    state.json      state, steps, seconds, attempt, error; replaced as a whole
    tests.jsonl     one line per test
    final.jsonl     the final test: one line for last, one for best
    events.jsonl    one line per event
    episodes.jsonl  one line per training episode, with the sampled values of domain randomization
    tensorboard/    scalars, and films
    play.mp4        test episodes of its policy, after `karolos play`
    checkpoints/    best and last
    export/         its policy for use without karolos, after `karolos export`
    transfers.jsonl one line per test of its policies under changed settings
    labels.json     tags and note
    robot/          copies of an arm's file and its meshes, of the robot `urdf`
    progress.json   its progress, while a launcher's process executes it
    launch.json     host of that process, the software that it must have, and why it refused (`problem`)
    stop            reason to stop for that process, written by the process that follows the run
    slurm.job       the number of its job on Slurm
    lock            held by the process that runs it, for as long as it lives

Only the process that holds the lock writes. Exceptions are stop, launch.json and slurm.job, and files that are made
later: films, export, transfers.jsonl and labels.json; the last two have their own locks. The state `lost` is never
written: it means that the run has begun and not ended, and no process holds the lock. A run that is `created` waits for
its start.
"""

from .run_folder import RunFolder, paths, scan

__all__ = ["RunFolder", "paths", "scan"]
