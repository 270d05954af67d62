"""The results of a run: Learn Ability, the results of every robot, and the run's files."""
