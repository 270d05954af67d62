"""Tables, figures, films, reports and the window."""
