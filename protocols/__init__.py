"""The experiments: agents, lives, statistics, studies, tables, films, the command `musebot`."""
