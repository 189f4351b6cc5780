"""MAC23 and MAC34: one axis core, several faces."""
