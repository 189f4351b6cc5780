"""``axistwin run``: twins on a line or a bus, served until a signal ends it."""
