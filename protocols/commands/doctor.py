"""`musebot doctor`: reports what is installed and what is missing."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class DoctorCommand:
    """Report what is installed, what renders, and what is missing and how to get it."""

    def __call__(self) -> None:
        """Exits with 1 where something is missing."""
        from .. import doctor

        raise SystemExit(doctor.report())
