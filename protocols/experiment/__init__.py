"""What is simulated, as data: schedules, conditions, experiments, plans."""
