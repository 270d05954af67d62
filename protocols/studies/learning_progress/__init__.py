"""The study of brains at nine times of their training (`musebot study learning-progress`)."""
