"""The command `musebot`."""
