"""What people see of runs: tables, figures, the report, films, and the window."""
