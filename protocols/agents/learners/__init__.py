"""Online learners from the literature, with which the paper's robots are compared."""
