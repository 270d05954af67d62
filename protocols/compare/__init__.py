"""Studies of agents (`musebot benchmark`): each has options, jobs and a page of results."""
