"""The checks of the serial face alone."""
