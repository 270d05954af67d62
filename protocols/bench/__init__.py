"""Speed and memory, compared with the bare physics: `musebot bench`."""
