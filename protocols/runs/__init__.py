"""What is simulated and how: experiments, cohorts, checkpoints, and the files of a run."""
