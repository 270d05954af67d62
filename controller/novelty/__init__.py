"""Other ways to propose actions than noise in the connections of the creative memory."""
