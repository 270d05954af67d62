"""The study of ways to propose actions (docs/plans/proposers.md)."""
