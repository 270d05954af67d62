"""Who drives the robots: the paper's neurocontroller, baselines, and agents of a user's own."""
