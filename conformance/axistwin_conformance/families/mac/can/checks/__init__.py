"""The checks of the CAN face alone."""
