"""The study that evolves parameters of a brain (`musebot study evolve`)."""
