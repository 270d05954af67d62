"""Measures speed and memory, compared with bare physics (`musebot bench`)."""
