"""A fifth family of devices, to show what one takes: a lamp on a serial line."""
