"""Online learners from the literature, to compare the paper's robots with; one a module."""
