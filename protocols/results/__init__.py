"""What a run leaves: Learn Ability, the results of every robot, and the run's files."""
