"""`musebot doctor`: reports what is installed and what is missing."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class DoctorCommand:
    """Report what is installed, what renders, and what is missing and how to get it."""

    def __call__(self) -> None:
        """Prints a line for each check.

        Raises:
          RunError: something is missing.
        """
        from ..errors import RunError
        from . import diagnosis as doctor

        if doctor.report():
            raise RunError("something that musebot requires is missing here")
