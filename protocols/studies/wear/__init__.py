"""The study of an old brain in a changed body (`musebot study wear`)."""
