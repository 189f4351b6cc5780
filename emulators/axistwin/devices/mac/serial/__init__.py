"""MAC modules on a serial line: expert frames over the axis core."""
