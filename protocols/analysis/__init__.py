"""Numbers only: intervals, hypothesis tests, comparisons of runs, and the paper's claims."""
