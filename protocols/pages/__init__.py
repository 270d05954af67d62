"""What people see of runs: tables, figures, the report, films, and the window."""

import contextlib as _contextlib
import os as _os
import sys as _sys

# Figures need no backend. Matplotlib cannot be imported while MPLBACKEND names one that it does not
# know, so the variable is applied after the import, as Matplotlib does, and ignored if unknown.
if "matplotlib" not in _sys.modules and (_backend := _os.environ.pop("MPLBACKEND", None)):
    with _contextlib.suppress(ImportError, ValueError):
        import matplotlib as _matplotlib

        _matplotlib.rcParams["backend"] = _backend
    _os.environ["MPLBACKEND"] = _backend
