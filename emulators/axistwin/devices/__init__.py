"""Devices: firmware as state machines.  They never import one another, nor a clock, nor IO."""
