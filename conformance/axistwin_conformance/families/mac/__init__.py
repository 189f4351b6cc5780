"""The MAC23 and MAC34: one axis, on a serial line and on CAN."""
