"""Speed and memory, compared with the raw physics: `musebot bench`."""
