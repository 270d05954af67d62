"""The experiments: schedules as data, lives, Learn Ability, tables, films, the command line."""
