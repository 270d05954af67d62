"""The study of readings of the paper (`musebot study reading`)."""
