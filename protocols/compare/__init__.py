"""Studies that rank agents: options, the jobs that they need, and a page (`musebot benchmark`)."""
