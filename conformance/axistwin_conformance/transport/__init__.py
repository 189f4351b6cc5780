"""The ways to a device: a serial line, a CAN bus, and the rig around it."""
