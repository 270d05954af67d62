"""The experiments: schedules as data, lives, Learn Ability, tables, films, the command line."""

import warnings

# dm_control looks for a display as soon as it is imported; `explore` alone opens a window, and says
# itself what is wrong.
warnings.filterwarnings("ignore", module="glfw")
